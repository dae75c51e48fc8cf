// What does the session do, and what is it told to do? The bar at the top.

import { call, Problem, sessionPath } from "./api.js";
import { byId, setText } from "./dom.js";
import { stateWord } from "./format.js";
import { isGone, isRecording, iterates, newestIteration, state, subscribe, update } from "./state.js";
import * as timeline from "./timeline.js";

let untilCertain = false; // whether the last that it was told is to go on until it is certain

export function install() {
  byId("play").addEventListener("click", playOrPause);
  byId("step").addEventListener("click", step);
  byId("reset").addEventListener("click", () => byId("really-reset").showModal());
  byId("really-reset").addEventListener("close", (event) => {
    if (event.target.returnValue === "reset") order("reset", {});
  });
  byId("run-some").addEventListener("submit", (event) => {
    event.preventDefault();
    byId("run-menu").hidePopover();
    run({ iterations: Math.max(1, Number(byId("run-number").value) || 1) });
  });
  for (const until of ["certain", "converged"]) {
    byId(`run-${until}`).addEventListener("click", async () => {
      byId("run-menu").hidePopover();
      await run({ until });
      untilCertain = until === "certain";
      show(); // at rest it may be that no event comes
    });
  }
  byId("trouble-close").addEventListener("click", () => {
    untilCertain = false;
    update({ trouble: "" });
  });
  subscribe(["session", "rows", "lost", "trouble", "view", "playback"], show);
}

export function playOrPause() {
  if (isRecording() || isGone()) return;
  if (iterates()) order("pause", {});
  else run({});
}

export function step() {
  if (isRecording() || isGone() || iterates()) return;
  timeline.live();
  order("step", { iterations: 1 });
}

// What is shown follows from where it stands, at the timeline's speed.
export function run(body) {
  timeline.follow(newestIteration());
  return order("run", body);
}

async function order(verb, body) {
  untilCertain = false;
  try {
    // what came of it is told by the events, in order: the answer may come after a later state
    await call(`${sessionPath(state.id)}/${verb}`, { method: "POST", body });
    update({ trouble: "" });
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    update({ trouble: error.status === 0 ? "" : error.message, lost: error.status === 0 || state.lost });
  }
}

function show() {
  const session = state.session;
  if (!session) return;
  const here = session.state;
  const name = session.name || `${isRecording() ? "Recording" : "Session"} ${session.id}`;
  setText(byId("name"), name);
  byId("name").title = name;
  document.title = `${name}: pmpnbp`;
  byId("state").dataset.state = state.lost ? "lost" : here;
  setText(byId("state-word"), state.lost ? "connection lost" : stateWord(session));

  const at = newestIteration();
  const going = iterates();
  const total = going ? session.iterations : Math.max(at, 1);
  setText(byId("progress-number"), going ? `${at} of ${session.iterations}` : `${at}`);
  byId("progress-bar").style.width = `${Math.min(100, (100 * at) / Math.max(1, total))}%`;

  const fixed = isRecording() || isGone();
  for (const id of ["play", "step", "run-open", "reset"]) byId(id).disabled = fixed || state.lost;
  byId("buttons").hidden = isRecording();
  byId("step").disabled ||= going;
  byId("run-open").disabled ||= going;
  byId("play").dataset.going = String(going);
  // at rest it is not what comes next
  for (const id of ["play", "run-open"]) byId(id).classList.toggle("primary", going || !session.converged);
  byId("play").setAttribute("aria-label", going ? "Pause" : "Run");
  setText(byId("play-word"), going ? "Pause" : "Run");

  const trouble = state.lost
    ? "The connection to the server is lost. This page tries again by itself, and comes back to where it was."
    : session.error || state.trouble || state.view.error;
  const notice = trouble ? "" : whyNotCertain(session);
  byId("trouble").hidden = !trouble && !notice;
  byId("trouble").dataset.kind = state.lost ? "lost" : notice ? "notice" : "error";
  byId("trouble-close").hidden = state.lost || Boolean(session.error);
  setText(byId("trouble-text"), trouble || notice);
}

// What is said where it was to go on until it is certain, and has come to rest without: no iteration changes that.
function whyNotCertain({ converged, certain, fit }) {
  if (!untilCertain || iterates() || state.playback || !converged || certain) return "";
  const rest = "It is at rest and not certain, and more iterations will not make it so.";
  return fit === "good" ? `${rest} “Where to look next” under Belief tells what another scan would bring.` : rest;
}
