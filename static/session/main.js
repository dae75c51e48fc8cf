// The page of one session: puts its pieces together. What each does is told in its own file.

import { call } from "./api.js";
import * as compare from "./compare.js";
import * as controls from "./controls.js";
import { find } from "./dom.js";
import * as economy from "./economy.js";
import * as edge from "./edge.js";
import * as estimate from "./estimate.js";
import * as graph from "./graph.js";
import { follow, wantEstimate } from "./history.js";
import * as keyboard from "./keyboard.js";
import * as layers from "./layers.js";
import * as part from "./part.js";
import * as particle from "./particle.js";
import * as plots from "./plots.js";
import * as settings from "./settings.js";
import * as share from "./share.js";
import { isLive, isRecording, newest, on, onTheme, put, state, theme } from "./state.js";
import * as tabs from "./tabs.js";
import * as timeline from "./timeline.js";
import { change, openView } from "./view.js";

const AGAIN = 2000; // milliseconds to the next try where the server does not answer

begin();

async function begin() {
  const frame = find("scene");
  state.id = decodeURIComponent(location.pathname.split("/")[2]);
  state.viewId = viewId();
  const first = share.restored(location.search);
  controls.install();
  tabs.install(new URLSearchParams(location.search).get("tab"));
  for (const piece of [timeline, plots, graph, estimate, part, edge, particle, layers, economy, compare, share]) piece.install();
  keyboard.install(frame);
  settings.install().catch((error) => put({ trouble: error.message }));
  const asked = new URLSearchParams(location.search).get("economy");
  const sparing = asked === null ? economy.withoutGraphicsCard() : asked !== "0";
  if (!(await reached(sparing))) return;
  await openView({ ...first, economy: sparing });
  frame.src = `/sessions/${encodeURIComponent(state.id)}/view/${state.viewId}/${sparing ? "?economy" : ""}`;
  on(["rows", "view", "lost"], wantEstimate);
  on(["view", "tab"], address);
  onTheme(() => change({ theme: theme() }));
  document.addEventListener("visibilitychange", () => {
    change({ hidden: document.hidden });
    wantEstimate();
  });
  // where somebody clicked in the scene, the reason is what they want to see
  let before = state.view.particle;
  let seen = newest();
  on(["view", "rows"], () => {
    const particle = state.view.particle;
    if (particle !== null && particle !== before) {
      if (before === null) tabs.open("why");
      if (isLive() && state.session.state === "running") change({ iteration: seen }); // it would be gone in a moment
    } else if (particle !== null && isLive() && newest() !== seen) change({ particle: null });
    before = state.view.particle;
    seen = newest();
  });
  document.body.dataset.ready = "true";
  if (isRecording()) damage();
}

// A recording of which not everything can be read says so; its other notes are the writer's, for programs.
async function damage() {
  const { notes } = await call(`/api/v1/recordings/${encodeURIComponent(state.id)}`).catch(() => ({ notes: [] }));
  const told = notes.filter((note) => note.includes("is damaged"));
  if (told.length) put({ trouble: `Of this recording, ${told.join("; ")}.` });
}

// Whether there is such a session; where the server does not answer it is asked until it does.
async function reached(sparing) {
  for (;;) {
    try {
      await follow(state.id, sparing);
      return true;
    } catch (error) {
      if (error.status !== 0 && error.status < 500) {
        put({ session: { id: state.id, name: "Not here", state: "deleted", error: error.message } });
        return false;
      }
      put({ lost: true, session: state.session ?? { id: state.id, state: "paused" } });
      await new Promise((resolve) => setTimeout(resolve, AGAIN));
    }
  }
}

// A tab's view keeps its name when it is loaded again, and another tab has another one.
function viewId() {
  const key = `view of ${state.id}`;
  const asked = new URLSearchParams(location.search).get("view");
  if (asked && /^[A-Za-z0-9_-]{1,64}$/.test(asked)) return asked;
  const name = sessionStorage.getItem(key) ?? crypto.getRandomValues(new Uint32Array(2)).reduce((text, value) => text + value.toString(16).padStart(8, "0"), "");
  sessionStorage.setItem(key, name);
  return name;
}

let written = null;
function address() {
  clearTimeout(written);
  written = setTimeout(() => {
    const given = share.query();
    const asked = new URLSearchParams(location.search);
    for (const name of ["view", "economy"]) if (asked.has(name)) given.set(name, asked.get(name));
    history.replaceState(null, "", location.pathname + (given.size ? `?${given}` : ""));
  }, 400);
}
