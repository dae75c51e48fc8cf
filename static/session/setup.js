// Where in the scan is it? The second step of a new session, and the third, to run it: what stands in the scan is offered
// as boxes to choose from, in a list and in the 3D view, where the chosen one can be drawn anew by its corners. The model
// can be laid into the scan, too, as a prior. Then the session begins anew with that, and runs until it is at rest.

import { add, sendFiles } from "./add_files.js";
import { call, sessionPath } from "./api.js";
import { byId, h, sentence, setContent, setText } from "./dom.js";
import { sessionId } from "./scene_frame.js";
import { isGone, isRecording, state, subscribe, update } from "./state.js";
import { follow } from "./timeline.js";
import { changeView } from "./view.js";

// What is looked at is the scan: the object is nowhere yet.
const BARE = { estimate: false, particles: false, draws: false, ellipsoids: false, next_views: false };
const wrong = sentence("setup-error");

let regions = []; // as GET regions has them
let own = null; // the box as it was drawn by hand, apart from those
let asked = ""; // of which scans the regions are known

const KEPT = `set-up of ${sessionId}`;
// The layers that were shown before, as long as it is open: it is so again when the tab is loaded again.
const kept = () => JSON.parse(sessionStorage.getItem(KEPT));
// whether the page begins with this
const first = kept() !== null || new URLSearchParams(location.search).has("setup");
// Asked for before the 3D view keeps the browser busy, where they are what is wanted; null where that failed.
let ahead = first ? whatStands().catch(() => null) : null;

export function install() {
  byId("setup-run").addEventListener("click", run);
  byId("setup").addEventListener("change", () => wrong("")); // it was about what was there before
  byId("setup-close").addEventListener("click", close);
  byId("setup-prior").addEventListener("change", (event) => changeView({ show: { prior: event.target.checked } }));
  byId("setup-open").addEventListener("click", open);
  byId("setup-draw").addEventListener("click", drawBox);
  byId("setup-files").addEventListener("change", ({ target }) => addView(target));
  subscribe(["view", "session"], show);
  if (canOpen() && first) open();
  else if (kept()) leave(); // it has been run meanwhile
}

export const isOpen = () => !byId("setup").hidden;
export const canOpen = () => !isRecording() && !isGone() && !isOpen() && state.session?.state !== "running";

async function open() {
  if (isOpen()) return;
  const again = kept() !== null;
  if (!again) sessionStorage.setItem(KEPT, JSON.stringify(state.view.show));
  byId("setup").hidden = false;
  wrong("");
  fillAdvanced();
  changeView({ show: BARE });
  await propose(again);
  byId("setup-run").focus({ preventScroll: true });
}

// A box around the object is what the search lacks most often.
export async function drawBox() {
  await open();
  changeView({ show: { region: true } });
}

export function close() {
  byId("setup").hidden = true;
  leave();
  show();
  byId("setup-open").focus({ preventScroll: true });
}

function leave() {
  changeView({ proposals: [], show: { ...kept(), region: false, prior: false } });
  sessionStorage.removeItem(KEPT);
}

// Asks for what stands there, once for the same scans; the likest is chosen where the session has no region of its own
// and none was chosen before.
async function propose(wasChosen = false) {
  const scans = String(state.session?.scan_ids);
  if (asked === scans) return offer(wasChosen);
  setText(byId("setup-title"), "Looking at what stands in the scan…");
  try {
    regions = ((await ahead) ?? (await whatStands())).regions;
    asked = scans;
  } catch (problem) {
    regions = [];
    wrong(problem.message);
  }
  ahead = null;
  offer(wasChosen);
}

function whatStands() {
  return call(`${sessionPath(sessionId)}/regions`);
}

function offer(wasChosen) {
  const { region, show: layers } = state.view;
  const chosen = wasChosen ? layers.region && region : (state.session?.roi ?? regions[0]?.roi);
  changeView({ proposals: regions.map(({ roi }) => roi), show: { region: Boolean(chosen) } });
  if (chosen) changeView({ region: chosen, look: "fit" });
  show();
}

async function addView(input) {
  wrong("");
  try {
    for (const { id } of await sendFiles(input)) await add(id, "joins");
    await propose();
  } catch (problem) {
    wrong(problem.message);
  }
}

const same = (one, other) => Boolean(one && other) && one.every((number, at) => Math.abs(number - other[at]) < 1e-6);

function show() {
  byId("setup-open").hidden = !canOpen();
  if (!isOpen() || !asked) return;
  if (state.session.state === "running" && !byId("setup-run").disabled) return close(); // somebody else has run it
  const everything = !state.view.show.region;
  const region = state.view.region;
  const taken = everything ? -1 : regions.findIndex(({ roi }) => same(roi, region));
  if (!everything && taken < 0 && region) own = region;
  setText(byId("setup-title"), title());
  const choices = regions.map(({ roi, size }, at) =>
    choice(`${at + 1}`, sizeText(size), at === taken, () => choose(roi), at === 0 ? "most like the model" : ""),
  );
  const name = same(own, state.session?.roi) ? "this session’s box" : "my own box";
  if (own) choices.push(choice("✎", name, !everything && taken < 0, () => choose(own), sizeOf(own)));
  choices.push(choice("∗", "anywhere in the scan", everything, () => changeView({ show: { region: false } })));
  setContent(byId("setup-choices"), choices);
  byId("setup-draw").hidden = !everything;
  byId("setup-hint").hidden = everything;
  for (const id of ["setup-numbers", "setup-box-hint"]) byId(id).hidden = everything;
  byId("setup-prior").checked = Boolean(state.view.show.prior);
  byId("setup-prior-hint").hidden = !state.view.show.prior;
}

function title() {
  if (!regions.length) return "Nothing stands out of floor and walls: where is it?";
  if (regions.length === 1) return "One thing stands here: this one?";
  return `${regions.length} things stand here: which one?`;
}

const choose = (region) => changeView({ region, show: { region: true } });

function choice(mark, text, chosen, press, more = "") {
  return h("li", {}, [
    h("button", { type: "button", class: "choice", "aria-pressed": String(chosen), on: { click: press } }, [
      h("span", { class: "mark", "aria-hidden": "true" }, mark),
      h("span", {}, text),
      more ? h("span", { class: "quiet" }, more) : null,
    ]),
  ]);
}

const cm = (metres) => Math.round(metres * 100);
const sizeText = ([height, long, short]) => `${cm(long)} × ${cm(short)} cm, ${cm(height)} high`;
const sizeOf = (box) => `${[0, 1, 2].map((axis) => cm(box[axis + 3] - box[axis])).join(" × ")} cm`;

// Method, particles and seed are a session's for life, and so are asked before it.
function fillAdvanced() {
  const { method, particles, seed, prior } = state.session;
  byId("setup-method").value = method;
  byId("setup-particles").value = particles;
  byId("setup-seed").value = seed;
  byId("setup-orientation").value = prior?.kind === "uniform" ? prior.orientation : "upright";
  changeView({ show: { prior: prior?.kind === "gaussian" } });
}

function members() {
  const view = state.view;
  const numbers = { particles: byId("setup-particles").valueAsNumber, seed: byId("setup-seed").valueAsNumber };
  for (const [name, number] of Object.entries(numbers)) {
    if (!Number.isInteger(number)) throw new Error(`${name} is no whole number; expected one such as 400.`);
    const { min, max, validity } = byId(`setup-${name}`);
    const limits = max ? `from ${min} to ${max}` : `of at least ${min}`;
    if (!validity.valid) throw new Error(`${name} is ${number}; expected a whole number ${limits}.`);
  }
  return {
    roi: view.show.region ? view.region : null,
    prior:
      view.show.prior && view.prior ? view.prior : { kind: "uniform", orientation: byId("setup-orientation").value },
    method: byId("setup-method").value,
    ...numbers,
  };
}

async function run() {
  const button = byId("setup-run");
  button.disabled = true;
  wrong("");
  try {
    const asked = members();
    const session = await call(`${sessionPath(state.id)}/reset`, { method: "POST", body: asked });
    follow(0);
    await call(`${sessionPath(state.id)}/run`, { method: "POST", body: { until: "converged" } });
    update({ session: { ...state.session, ...asked, roi: session.roi } });
    close();
  } catch (problem) {
    wrong(problem.message);
  }
  button.disabled = false;
}
