// Where is every link, and how sure is that? Tables of links, joints and what sensor and model have wrong, or the part or
// edge that was chosen.

import { byId, reconcile, setName, setText } from "./dom.js";
import { joint, millimetres, percent } from "./format.js";
import { choosePart } from "./graph.js";
import { sensorAndModel } from "./sensor_and_model.js";
import { colour, onTheme, partOfLink, state, subscribe } from "./state.js";

export function install() {
  subscribe(["estimate", "graph", "view"], show);
  onTheme(show);
}

function show() {
  const chosen = state.view.part || state.view.edge;
  byId("all-links").hidden = Boolean(chosen);
  byId("part").hidden = !state.view.part;
  byId("edge").hidden = !state.view.edge || Boolean(state.view.part);
  if (!state.estimate || chosen) return;
  reconcile(byId("links"), "link-row", Object.entries(state.estimate.links), ([name]) => name, showLink);
  const joints = Object.entries(state.estimate.joints);
  byId("joints-title").hidden = !joints.length;
  reconcile(byId("joints"), "joint-row", joints, ([name]) => name, showJoint);
  const facts = sensorAndModel(state.estimate);
  byId("sensor-title").hidden = !facts.length;
  reconcile(byId("sensor"), "sensor-row", facts, ([name]) => name, showFact);
}

function showLink(row, [name, link]) {
  const part = partOfLink(name);
  row.querySelector("button").onclick = () => choosePart(part?.name ?? name);
  row.querySelector(".swatch").style.backgroundColor = colour(part);
  setName(row.querySelector(".long"), name);
  const [, std, visible, sure] = row.children;
  setText(std, millimetres(Math.max(...link.std_xyz)));
  setText(visible, percent(link.visible_fraction));
  setText(sure, link.certain ? "certain" : "not yet");
  sure.dataset.certain = String(link.certain);
}

function showJoint(row, [name, value]) {
  const [heading, position, std, type] = row.children;
  setName(heading, name);
  setText(position, joint(value.type, value.position));
  setText(std, `± ${joint(value.type, value.std, 2)}`);
  setText(type, value.type);
}

function showFact(row, texts) {
  for (const [place, cell] of [...row.children].entries()) setText(cell, texts[place]);
}
