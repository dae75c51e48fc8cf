// Which iteration is looked at? A slider over all that are recorded, with marks where something happened.

import { find, keyed, h, say } from "./dom.js";
import { colour, isLive, isRecording, maxStd, newest, oldest, on, put, shown, state } from "./state.js";
import { goTo } from "./view.js";

let timer = null;

export function install() {
  find("slider").addEventListener("input", (event) => {
    stop();
    goTo(Number(event.target.value));
  });
  find("live").addEventListener("click", live);
  find("playback").addEventListener("click", playback);
  find("speed").addEventListener("change", () => state.playback && start());
  on(["rows", "view", "playback"], show);
  on(["rows", "changes", "graph", "session"], marks);
}

export function live() {
  stop();
  goTo(null);
}

// Look so many iterations further, or back; beyond the newest it is live.
export function move(by) {
  stop();
  const next = shown() + by;
  if (next > newest()) live();
  else goTo(Math.max(oldest(), next));
}

export function playback() {
  if (state.playback) stop();
  else {
    if (isLive() || shown() >= newest()) goTo(oldest());
    start();
  }
}

function start() {
  clearInterval(timer);
  put({ playback: true });
  timer = setInterval(() => {
    if (shown() >= newest()) stop();
    else goTo(shown() + 1);
  }, 1000 / Number(find("speed").value));
}

function stop() {
  clearInterval(timer);
  timer = null;
  if (state.playback) put({ playback: false });
}

function show() {
  const slider = find("slider");
  slider.min = oldest();
  slider.max = Math.max(newest(), oldest());
  slider.value = shown();
  slider.setAttribute("aria-valuetext", `iteration ${shown()} of ${newest()}${isLive() ? ", live" : ""}`);
  const length = Math.max(1, newest() - oldest());
  slider.style.setProperty("--share", newest() > oldest() ? (shown() - oldest()) / length : 1);
  const digits = String(newest()).length;
  say(find("shown"), `${String(shown()).padStart(digits, "\u2007")} / ${newest()}`);
  find("live").setAttribute("aria-pressed", String(isLive()));
  say(find("live").lastChild, isRecording() ? "Newest" : "Live");
  find("playback").setAttribute("aria-label", state.playback ? "Stop playing back" : "Play back");
  find("playback").dataset.going = String(state.playback);
}

// Where a part became certain and stayed so, where settings or scans were changed, and what the inference remarked.
function marks() {
  const found = [];
  const rows = state.rows;
  state.graph.parts.forEach((part, at) => {
    let since = null;
    for (let n = rows.length - 1; n >= 0 && rows[n].std[at] !== null && rows[n].std[at] <= maxStd(); n--) since = n;
    if (since !== null && since > 0) {
      found.push({ kind: "certain", iteration: rows[since].iteration, part, text: `${part.name} is certain from iteration ${rows[since].iteration} on` });
    }
  });
  for (const entry of state.changes) {
    const what = entry.scan_id
      ? "a view was added"
      : `settings were changed: ${Object.entries(entry.config ?? {}).map(([name, value]) => `${name} = ${value}`).join(", ")}`;
    found.push({ kind: "change", iteration: entry.after_iteration, text: `after iteration ${entry.after_iteration} ${what}` });
  }
  for (const row of rows) {
    for (const note of row.notes ?? []) found.push({ kind: "change", iteration: row.iteration, text: `iteration ${row.iteration}: ${note}` });
  }
  const [first, last] = [oldest(), Math.max(newest(), oldest() + 1)];
  const level = new Map();
  keyed(
    find("marks"), found, (mark, at) => `${mark.kind}${mark.part?.name ?? at}`,
    (mark) => h("li", { class: `mark ${mark.kind}`, on: { click: () => goTo(mark.iteration) } }, h("span", { class: "unseen" })),
    (place, mark) => {
      const here = level.get(mark.iteration) ?? 0;
      level.set(mark.iteration, here + 1);
      place.style.setProperty("--at", (mark.iteration - first) / (last - first));
      place.style.setProperty("--level", here);
      if (mark.part) place.style.setProperty("--part", colour(mark.part));
      place.title = mark.text;
      say(place.firstChild, mark.text);
    },
  );
}
