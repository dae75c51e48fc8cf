// Where is every link, and how sure is that? Tables of links and joints, or the part or edge that was chosen.

import { find, h, keyed, say } from "./dom.js";
import { joint, millimetres, percent } from "./format.js";
import { choosePart } from "./graph.js";
import { colour, on, onTheme, partOfLink, state } from "./state.js";

export function install() {
  on(["estimate", "graph", "view"], show);
  onTheme(show);
}

function show() {
  const chosen = state.view.part || state.view.edge;
  find("all-links").hidden = Boolean(chosen);
  find("part").hidden = !state.view.part;
  find("edge").hidden = !state.view.edge || Boolean(state.view.part);
  if (!state.estimate || chosen) return;
  keyed(find("links"), Object.entries(state.estimate.links), ([name]) => name, makeLink, showLink);
  const joints = Object.entries(state.estimate.joints);
  find("joints-title").hidden = !joints.length;
  keyed(find("joints"), joints, ([name]) => name, makeJoint, showJoint);
}

function makeLink([name]) {
  const press = () => choosePart(partOfLink(name)?.name ?? name);
  return h("tr", {},
    h("th", { scope: "row" }, h("button", { type: "button", class: "plain", on: { click: press } },
      h("span", { class: "swatch", "aria-hidden": "true" }), h("span", {}, name))),
    h("td", { class: "figure" }), h("td", { class: "figure" }), h("td", { class: "sure" }));
}

function showLink(row, [name, link]) {
  row.querySelector(".swatch").style.backgroundColor = colour(partOfLink(name));
  const [, std, visible, sure] = row.children;
  say(std, millimetres(Math.max(...link.std_xyz)));
  say(visible, percent(link.visible_fraction));
  say(sure, link.certain ? "certain" : "not yet");
  sure.dataset.certain = String(link.certain);
}

function makeJoint([name]) {
  return h("tr", {}, h("th", { scope: "row" }, name), h("td", { class: "figure" }), h("td", { class: "figure quiet" }), h("td", { class: "quiet" }));
}

function showJoint(row, [, value]) {
  const [, position, std, type] = row.children;
  say(position, joint(value.type, value.position));
  say(std, `± ${joint(value.type, value.std, 2)}`);
  say(type, value.type);
}
