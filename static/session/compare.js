// How does it differ from another session, or from this one at another iteration? The other's estimate stands as a ghost
// in the 3D view, and here is a table of differences.

import { call, iterationQuery, sessionPath } from "./api.js";
import { button, byId, h, reconcile, sentence, setName, setText } from "./dom.js";
import { degrees, fineCentimetres, inFineCentimetres, joint, largest } from "./format.js";
import { angle, distance } from "./pose.js";
import { colour, isLive, shownIteration, state, subscribe, update } from "./state.js";
import { throttled } from "./throttle.js";
import { changeView } from "./view.js";

let newestOther = null;

export function install() {
  byId("compare-with").addEventListener("change", choose);
  byId("compare-at").addEventListener("change", (event) => {
    const at = event.target.value;
    changeView({ compare: { ...state.view.compare, iteration: at === "" ? null : Number(at) } });
  });
  byId("compare-tied").addEventListener("change", tie);
  const pin = () => changeView({ compare: { session_id: state.id, iteration: shownIteration() } });
  byId("compare-pin").append(button("Pin this iteration to compare with", pin, { class: "wide" }));
  byId("compare-stop").addEventListener("click", () => changeView({ compare: null }));
  const ask = throttled(fetchOther, () => JSON.stringify(state.view.compare), sentence("compare-calm"));
  let opened = false;
  subscribe(["tab", "view", "rows"], () => {
    if (state.tab === "compare" && !opened) list();
    opened = state.tab === "compare";
    tie();
    if (state.tab === "compare" || state.view.compare) ask();
  });
  subscribe(["view", "estimate", "other", "graph", "tab"], show);
}

async function list() {
  const kinds = ["sessions", "recordings"];
  const [sessions, recordings] = await Promise.all(kinds.map((kind) => call(`/api/v1/${kind}`).catch(() => [])));
  const options = [
    h("option", { value: "" }, "nothing"),
    h("option", { value: state.id }, "this session, at another iteration"),
    ...sessions
      .filter((one) => one.id !== state.id && one.iteration !== null)
      .map((one) => h("option", { value: one.id }, `${one.name || one.id} (${one.iteration})`)),
    ...recordings
      .filter((one) => one.id !== state.id)
      .map((one) => h("option", { value: one.id }, `recording ${one.file_name} (${one.last_iteration})`)),
  ];
  byId("compare-with").replaceChildren(...options);
  show();
}

function choose(event) {
  const id = event.target.value;
  newestOther = null;
  changeView({
    compare: id ? { session_id: id, iteration: id === state.id ? Math.max(0, shownIteration() - 1) : null } : null,
  });
}

// The other's iteration follows this one's, as far as it has come.
function tie() {
  const other = state.view.compare;
  if (!other || other.session_id === state.id || !byId("compare-tied").checked) return;
  const wanted = isLive() ? null : newestOther === null ? shownIteration() : Math.min(shownIteration(), newestOther);
  if (other.iteration !== wanted) changeView({ compare: { ...other, iteration: wanted } });
}

async function fetchOther() {
  const other = state.view.compare;
  if (!other) {
    update({ other: null });
    return;
  }
  if (newestOther === null || other.iteration === null || other.iteration > newestOther)
    newestOther = (await call(sessionPath(other.session_id))).iteration;
  if (state.view.compare?.session_id !== other.session_id) return; // it was stopped meanwhile
  const iteration = other.iteration === null ? null : Math.min(other.iteration, newestOther);
  if (iteration !== other.iteration) {
    byId("compare-at").value = iteration; // also where it was just typed: what is shown stands there
    changeView({ compare: { ...other, iteration } });
  }
  update({ other: await call(`${sessionPath(other.session_id)}/estimate${iterationQuery(iteration)}`) });
}

function show() {
  const [here, other] = [state.estimate, state.view.compare && state.other];
  const chosen = state.view.compare;
  byId("compare-with").value = chosen?.session_id ?? "";
  byId("compare-options").hidden = !chosen;
  byId("compare-none").hidden = Boolean(chosen);
  byId("compare-tables").hidden = !other || !here;
  byId("compare-tied-row").hidden = !chosen || chosen.session_id === state.id;
  if (!chosen) return;
  if (document.activeElement !== byId("compare-at")) byId("compare-at").value = chosen.iteration ?? "";
  byId("compare-at").max = newestOther ?? "";
  if (!other || !here) return;
  setText(byId("compare-what"), `Iteration ${here.iteration} here, iteration ${other.iteration} there`);
  setText(byId("compare-fit"), `Fit: ${fit(here)} here, ${fit(other)} there`);
  byId("compare-fit").title = [here.fit_reason, other.fit_reason].map((reason) => reason ?? "–").join("; there ");
  // links that are fixed to each other are one part: the first of them tells of all
  const parts = state.graph.parts.filter(({ links: [link] }) => here.links[link] && other.links[link]);
  reconcile(
    byId("compare-links"),
    "compare-link-row",
    parts,
    ({ name }) => name,
    (row, part) => {
      row.querySelector(".swatch").style.backgroundColor = colour(part);
      const [name] = part.links;
      const [a, b] = [here.links[name], other.links[name]];
      const [heading, apart, turned, stdHere, stdThere] = row.children;
      setName(heading.lastChild, part.name);
      setText(apart, fineCentimetres(distance(a.pose.position, b.pose.position)));
      setText(turned, degrees(angle(a.pose.orientation, b.pose.orientation)));
      setText(stdHere, inFineCentimetres(largest(a.std_xyz)));
      setText(stdThere, inFineCentimetres(largest(b.std_xyz)));
    },
  );
  const joints = Object.keys(here.joints).filter((name) => other.joints[name]);
  offer("compare-links", parts);
  offer("compare-joints", joints);
  byId("compare-nothing").hidden = parts.length + joints.length > 0;
  reconcile(byId("compare-joints"), "compare-joint-row", joints, String, (row, name) => {
    const [a, b] = [here.joints[name], other.joints[name]];
    const [heading, ownPosition, otherPosition, apart] = row.children;
    setName(heading, name);
    setText(ownPosition, joint(a.type, a.position));
    setText(otherPosition, joint(b.type, b.position));
    setText(apart, Array.isArray(a.position) ? "–" : joint(a.type, Math.abs(a.position - b.position), 2));
  });
}

// A table without a row is not there.
function offer(table, rows) {
  byId(table).closest("table").hidden = !rows.length;
}

const FITS = { good: "found", doubtful: "doubtful", none: "not found" };
const fit = (estimate) => FITS[estimate.fit] ?? "not at rest";
