// Which iteration is looked at? A slider over all that are recorded, with marks where something happened. The inference
// is faster than an eye: what is shown follows it at a pace that can be watched, and is live once it has caught up.

import { byId, reconcile, setText } from "./dom.js";
import {
  colour,
  isGone,
  isLive,
  isRecording,
  iterates,
  newestIteration,
  oldestIteration,
  shownIteration,
  state,
  subscribe,
  update,
} from "./state.js";
import { changeView, goToIteration } from "./view.js";

const PATIENCE = 1000; // milliseconds for which nothing more comes before it is live

let timer = null;

// Whether what this tab showed went on by itself when its page was left: loaded again, it does so again.
export const played = () => sessionStorage.getItem(key()) !== null;
const key = () => `plays ${state.id}`;

export function install() {
  byId("slider").addEventListener("input", (event) => {
    stop();
    goToIteration(Number(event.target.value));
  });
  byId("live").addEventListener("click", live);
  byId("playback").addEventListener("click", playback);
  byId("speed").addEventListener("change", () => state.playback && start());
  subscribe(["playback"], () => {
    if (state.playback) sessionStorage.setItem(key(), "");
    else sessionStorage.removeItem(key());
  });
  subscribe(["rows", "view", "playback", "session"], show);
  subscribe(["rows", "changes", "graph", "session"], showMarks);
}

export function live() {
  stop();
  goToIteration(null);
}

// Stay at an iteration: somebody looks at something of it, which would be gone with the next one.
export function hold(iteration) {
  stop();
  changeView({ iteration });
}

// Look so many iterations further, or back; beyond the newest it is live.
export function move(by) {
  stop();
  const next = shownIteration() + by;
  if (next > newestIteration()) live();
  else goToIteration(Math.max(oldestIteration(), next));
}

export function playback() {
  if (state.playback) stop();
  else follow(isLive() || shownIteration() >= newestIteration() ? oldestIteration() : shownIteration());
}

// Look at `iteration`, then at one after the other, at the chosen speed; live after the last, once no more are made.
export function follow(iteration) {
  goToIteration(iteration);
  start();
}

function start() {
  clearTimeout(timer);
  update({ playback: true });
  let came = performance.now();
  const go = () => {
    const more = shownIteration() < newestIteration();
    if (more || iterates()) came = performance.now();
    if (more) goToIteration(shownIteration() + 1);
    else if (performance.now() > came + PATIENCE) return live();
    wait();
  };
  // not an interval: a page that was held up would make up for it, and jump
  const wait = () => {
    timer = setTimeout(go, 1000 / Number(byId("speed").value));
  };
  wait();
}

function stop() {
  clearTimeout(timer);
  timer = null;
  if (state.playback) update({ playback: false });
}

function show() {
  const slider = byId("slider");
  const [first, at, last] = [oldestIteration(), shownIteration(), newestIteration()];
  Object.assign(slider, { min: first, max: Math.max(last, first), value: at });
  slider.setAttribute("aria-valuetext", `iteration ${at} of ${last}${isLive() ? ", live" : ""}`);
  slider.style.setProperty("--share", last > first ? (at - first) / (last - first) : 0);
  setText(byId("shown"), `${String(at).padStart(String(last).length, "\u2007")} / ${last}`);
  byId("live").setAttribute("aria-pressed", String(isLive() && !isGone()));
  byId("live").disabled = isGone();
  setText(byId("live").lastChild, isRecording() ? "Newest" : "Live");
  byId("playback").setAttribute("aria-label", state.playback ? "Stop playing back" : "Play back");
  byId("playback").dataset.going = String(state.playback);
}

// The place of the first row from which on all are so; null where the last is not.
function since(so) {
  let first = null;
  for (let n = state.rows.length - 1; n >= 0 && so(state.rows[n]); n--) first = n;
  return first;
}

// Where a part became certain and stayed so, where settings or scans were changed, and what the inference remarked.
function showMarks() {
  const marks = [];
  const rows = state.rows;
  state.graph.parts.forEach((part, at) => {
    const first = since((row) => row.certain?.[at]);
    if (first === null || first < 1) return;
    const { iteration } = rows[first];
    marks.push({ kind: "certain", iteration, part, text: `${part.name} is certain from iteration ${iteration} on` });
  });
  for (const { after_iteration: iteration, scan_id, mode, config } of state.changes) {
    const set = Object.entries(config ?? {}).map(([name, value]) => `${name} = ${value}`);
    const came = mode === "replaces" ? "the scene had changed" : "a view was added";
    const what = scan_id ? came : `settings were changed: ${set.join(", ")}`;
    marks.push({ kind: "change", iteration, text: `after iteration ${iteration} ${what}` });
  }
  for (const row of rows) {
    for (const note of row.notes ?? [])
      marks.push({ kind: "change", iteration: row.iteration, text: `iteration ${row.iteration}: ${note}` });
  }
  const [first, last] = [oldestIteration(), Math.max(newestIteration(), oldestIteration() + 1)];
  const level = new Map();
  reconcile(
    byId("marks"),
    "mark",
    marks,
    (mark, at) => `${mark.kind}${mark.part?.name ?? at}`,
    (place, mark) => {
      place.className = `mark ${mark.kind}`;
      place.onclick = () => goToIteration(mark.iteration);
      const here = level.get(mark.iteration) ?? 0;
      level.set(mark.iteration, here + 1);
      const share = (mark.iteration - first) / (last - first);
      place.style.setProperty("--at", share);
      place.style.setProperty("--level", share > 0.5 ? -here : here); // those of one iteration stay on the slider
      if (mark.part) place.style.setProperty("--part", colour(mark.part));
      place.title = mark.text;
      setText(place.firstChild, mark.text);
    },
  );
}
