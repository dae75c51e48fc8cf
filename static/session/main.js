// The page of one session: puts its pieces together. What each does stands in its own file.

import * as algorithm from "./algorithm.js";
import { call } from "./api.js";
import * as compare from "./compare.js";
import * as controls from "./controls.js";
import * as economy from "./economy.js";
import * as edge from "./edge.js";
import * as estimate from "./estimate.js";
import * as fromStart from "./from_start.js";
import * as graph from "./graph.js";
import { follow, refreshEstimate } from "./history.js";
import * as howSure from "./how_sure.js";
import * as keyboard from "./keyboard.js";
import * as layers from "./layers.js";
import * as newScan from "./new_scan.js";
import * as nextViews from "./next_views.js";
import * as overlays from "./overlays.js";
import * as pairPlot from "./pair_plot.js";
import * as part from "./part.js";
import * as particle from "./particle.js";
import * as plots from "./plots.js";
import * as sceneFrame from "./scene_frame.js";
import { see } from "./seen.js";
import * as settings from "./settings.js";
import * as setup from "./setup.js";
import * as share from "./share.js";
import * as splitters from "./splitters.js";
import {
  goesOn,
  isLive,
  isRecording,
  newestIteration,
  oldestIteration,
  onTheme,
  shownIteration,
  state,
  subscribe,
  theme,
  update,
} from "./state.js";
import * as tabs from "./tabs.js";
import * as timeline from "./timeline.js";
import * as verdict from "./verdict.js";
import { changeView, declareView, openView } from "./view.js";
import * as words from "./words.js";

const AGAIN = 2000; // milliseconds to the next try where the server does not answer
let awaited = false; // whether the server did not answer at once

begin();

async function begin() {
  state.id = sceneFrame.sessionId;
  state.viewId = sceneFrame.viewId;
  const { search } = location; // it is another once the page keeps it
  const first = share.viewOfLink(search);
  const watched = fromStart.asked(search);
  const playsOn = !watched && first.iteration === undefined && timeline.played();
  controls.install();
  await untilAnswered(declareView);
  if (watched) Object.assign(state, { playback: true, view: { ...state.view, iteration: 0 } }); // not the end before it
  tabs.install(new URLSearchParams(location.search).get("tab"));
  const about = [verdict, timeline, plots, graph, estimate, howSure, part, nextViews, pairPlot, algorithm, edge];
  for (const piece of [...about, particle, newScan, layers, overlays, economy, compare, share]) piece.install();
  keyboard.install();
  splitters.install();
  words.install();
  settings.install().catch((error) => update({ trouble: error.message }));
  if (!(await loadSession())) return;
  // a plain address is live, whatever this tab showed before; a named view is whoever's named it
  const plain = !playsOn && !new URLSearchParams(search).has("view") ? { iteration: null, particle: null } : {};
  const start = watched ? { iteration: oldestIteration() } : plain;
  await openView({ ...start, ...first, economy: sceneFrame.sparing }, sceneFrame.opened);
  if (playsOn) timeline.follow(shownIteration());
  if (awaited) sceneFrame.begin(); // what it loaded before was no 3D view
  subscribe(["rows", "view", "lost"], refreshEstimate);
  subscribe(["view", "tab", "playback"], keepAddress);
  onTheme(() => changeView({ theme: theme() }));
  document.addEventListener("visibilitychange", () => {
    changeView({ hidden: document.hidden });
    refreshEstimate();
  });
  // where somebody clicked in the scene, the reason is what they want to see
  let before = state.view.particle;
  let seen = newestIteration();
  subscribe(["view", "rows"], () => {
    const particle = state.view.particle;
    if (particle !== null && particle !== before) {
      if (before === null) tabs.open("why");
      if (goesOn()) timeline.hold(isLive() ? seen : state.view.iteration); // it would be gone in a moment
    } else if (particle !== null && isLive() && newestIteration() !== seen) changeView({ particle: null });
    before = state.view.particle;
    seen = newestIteration();
  });
  setup.install();
  document.body.dataset.ready = "true";
  see(state.id);
  if (watched) fromStart.watch(search);
  if (isRecording()) reportDamage();
}

// A recording of which not everything can be read says so; its other notes are the writer's, for programs.
async function reportDamage() {
  const { notes } = await call(`/api/v1/recordings/${encodeURIComponent(state.id)}`).catch(() => ({ notes: [] }));
  const damages = notes.filter((note) => note.includes("is damaged"));
  if (damages.length) update({ trouble: `Of this recording, ${damages.join("; ")}.` });
}

// Whether there is such a session.
async function loadSession() {
  try {
    await untilAnswered(() => follow(state.id, sceneFrame.sparing));
    return true;
  } catch (error) {
    sceneFrame.end();
    update({ session: { id: state.id, name: "Not here", state: "deleted", error: error.message } });
    return false;
  }
}

// What `ask` gives; where the server does not answer it is asked until it does.
async function untilAnswered(ask) {
  for (;;) {
    try {
      return await ask();
    } catch (error) {
      if (error.status !== 0 && error.status < 500) throw error;
      awaited = true;
      update({ lost: true, session: state.session ?? { id: state.id, state: "paused" } });
      await new Promise((resolve) => setTimeout(resolve, AGAIN));
    }
  }
}

let addressTimer = null;
// Also while what is shown changes without a pause.
function keepAddress() {
  if (addressTimer) return;
  addressTimer = setTimeout(() => {
    addressTimer = null;
    const given = share.linkParameters();
    const asked = new URLSearchParams(location.search);
    for (const name of ["view", "economy"]) if (asked.has(name)) given.set(name, asked.get(name));
    history.replaceState(null, "", location.pathname + (given.size ? `?${given}` : ""));
  }, 400);
}
