// How does it differ from another session, or from this one at another iteration? The other's estimate stands as a ghost
// in the 3D view, and here is a table of differences.

import { at, call, root } from "./api.js";
import { button, find, h, keyed, say } from "./dom.js";
import { DEGREES, degrees, joint, millimetres, number } from "./format.js";
import { colour, isLive, on, partOfLink, put, shown, state } from "./state.js";
import { change } from "./view.js";
import { paced } from "./pace.js";

let newestOther = null;

export function install() {
  find("compare-with").addEventListener("change", choose);
  find("compare-at").addEventListener("change", () => change({ compare: { ...state.view.compare, iteration: find("compare-at").value === "" ? null : Number(find("compare-at").value) } }));
  find("compare-tied").addEventListener("change", tie);
  find("compare-pin").append(button("Pin this iteration to compare with", () => change({ compare: { session_id: state.id, iteration: shown() } }), { class: "wide" }));
  find("compare-stop").addEventListener("click", () => change({ compare: null }));
  const ask = paced(fetchOther, () => JSON.stringify(state.view.compare), (text) => {
    find("compare-calm").hidden = !text;
    say(find("compare-calm"), text);
  });
  let opened = false;
  on(["tab", "view", "rows"], () => {
    if (state.tab === "compare" && !opened) list();
    opened = state.tab === "compare";
    tie();
    if (state.tab === "compare" || state.view.compare) ask();
  });
  on(["view", "estimate", "other", "graph", "tab"], show);
}

async function list() {
  const [sessions, recordings] = await Promise.all([
    call("/api/v1/sessions").catch(() => []), call("/api/v1/recordings").catch(() => []),
  ]);
  const options = [
    h("option", { value: "" }, "nothing"),
    h("option", { value: state.id }, "this session, at another iteration"),
    ...sessions.filter((one) => one.id !== state.id && one.iteration !== null).map((one) => h("option", { value: one.id }, `${one.name || one.id} (${one.iteration})`)),
    ...recordings.filter((one) => one.id !== state.id).map((one) => h("option", { value: one.id }, `recording ${one.name ?? one.id} (${one.last_iteration})`)),
  ];
  find("compare-with").replaceChildren(...options);
  show();
}

function choose(event) {
  const id = event.target.value;
  newestOther = null;
  change({ compare: id ? { session_id: id, iteration: id === state.id ? Math.max(0, shown() - 1) : null } : null });
}

// The other's iteration follows this one's, as far as it has come.
function tie() {
  const other = state.view.compare;
  if (!other || other.session_id === state.id || !find("compare-tied").checked) return;
  const wanted = isLive() ? null : newestOther === null ? shown() : Math.min(shown(), newestOther);
  if (other.iteration !== wanted) change({ compare: { ...other, iteration: wanted } });
}

async function fetchOther() {
  const other = state.view.compare;
  if (!other) {
    put({ other: null });
    return;
  }
  if (newestOther === null || other.iteration === null) newestOther = (await call(root(other.session_id))).iteration;
  const iteration = other.iteration === null ? null : Math.min(other.iteration, newestOther);
  put({ other: await call(`${root(other.session_id)}/estimate${at(iteration)}`) });
}

function show() {
  const [here, other] = [state.estimate, state.view.compare && state.other];
  const chosen = state.view.compare;
  find("compare-with").value = chosen?.session_id ?? "";
  find("compare-options").hidden = !chosen;
  find("compare-none").hidden = Boolean(chosen);
  find("compare-tables").hidden = !other || !here;
  find("compare-tied-row").hidden = !chosen || chosen.session_id === state.id;
  if (!chosen) return;
  if (document.activeElement !== find("compare-at")) find("compare-at").value = chosen.iteration ?? "";
  find("compare-at").max = newestOther ?? "";
  if (!other || !here) return;
  say(find("compare-what"), `Iteration ${here.iteration} here, iteration ${other.iteration} there`);
  const links = Object.keys(here.links).filter((name) => other.links[name]);
  keyed(find("compare-links"), links, (name) => name,
    (name) => h("tr", {}, h("th", { scope: "row" }, h("span", { class: "swatch", "aria-hidden": "true" }), ` ${name}`), ...Array.from({ length: 4 }, () => h("td", { class: "figure" }))),
    (row, name) => {
      row.querySelector(".swatch").style.backgroundColor = colour(partOfLink(name));
      const [a, b] = [here.links[name], other.links[name]];
      const [, apart, turned, stdHere, stdThere] = row.children;
      say(apart, millimetres(distance(a.pose.position, b.pose.position)));
      say(turned, degrees(angle(a.pose.orientation, b.pose.orientation)));
      say(stdHere, number(Math.max(...a.std_xyz) * 1000, 1));
      say(stdThere, number(Math.max(...b.std_xyz) * 1000, 1));
    });
  const joints = Object.keys(here.joints).filter((name) => other.joints[name]);
  keyed(find("compare-joints"), joints, (name) => name,
    (name) => h("tr", {}, h("th", { scope: "row" }, name), ...Array.from({ length: 3 }, () => h("td", { class: "figure" }))),
    (row, name) => {
      const [a, b] = [here.joints[name], other.joints[name]];
      const [, mine, theirs, apart] = row.children;
      say(mine, joint(a.type, a.position));
      say(theirs, joint(b.type, b.position));
      say(apart, Array.isArray(a.position) ? "–" : joint(a.type, Math.abs(a.position - b.position), 2));
    });
}

const distance = (a, b) => Math.hypot(a.x - b.x, a.y - b.y, a.z - b.z);

function angle(a, b) {
  const dot = Math.abs(a.x * b.x + a.y * b.y + a.z * b.z + a.w * b.w);
  const between = 2 * Math.acos(Math.min(1, dot));
  return between * DEGREES < 0.02 ? 0 : between; // below that the cosine has no digits left
}
