// What does the session do, and what is it told to do? The bar at the top.

import { call, Problem, sessionPath } from "./api.js";
import { byId, setText } from "./dom.js";
import { stateWord } from "./format.js";
import { isRecording, iterates, newestIteration, state, subscribe, update } from "./state.js";
import * as timeline from "./timeline.js";

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
    byId(`run-${until}`).addEventListener("click", () => {
      byId("run-menu").hidePopover();
      run({ until });
    });
  }
  byId("trouble-close").addEventListener("click", () => update({ trouble: "" }));
  subscribe(["session", "rows", "lost", "trouble", "view"], show);
}

export function playOrPause() {
  if (isRecording()) return;
  if (iterates()) order("pause", {});
  else run({});
}

export function step() {
  if (isRecording() || iterates()) return;
  timeline.live();
  order("step", { iterations: 1 });
}

// What is shown follows from where it stands, at the timeline's speed.
export function run(body) {
  timeline.follow(newestIteration());
  order("run", body);
}

async function order(verb, body) {
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

  const fixed = isRecording() || here === "deleted";
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
  byId("trouble").hidden = !trouble;
  byId("trouble").dataset.kind = state.lost ? "lost" : "error";
  byId("trouble-close").hidden = state.lost || Boolean(session.error);
  setText(byId("trouble-text"), trouble ?? "");
}
