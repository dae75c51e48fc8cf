// What does the session do, and what is it told to do? The bar at the top.

import { call, Problem, root } from "./api.js";
import { find, say } from "./dom.js";
import { askChanges } from "./history.js";
import { isLive, isRecording, newest, on, put, state } from "./state.js";
import { goTo } from "./view.js";

const WORDS = {
  running: "iterating",
  waiting: "waiting for a free place",
  paused: "paused",
  failed: "stopped by an error",
  recorded: "recording",
  deleted: "deleted",
};

export function install() {
  find("play").addEventListener("click", playOrPause);
  find("step").addEventListener("click", step);
  find("reset").addEventListener("click", () => find("really-reset").showModal());
  find("really-reset").addEventListener("close", (event) => {
    if (event.target.returnValue === "reset") order("reset", {}, "Reset").then(askChanges);
  });
  find("run-some").addEventListener("submit", (event) => {
    event.preventDefault();
    find("run-menu").hidePopover();
    run({ iterations: Math.max(1, Number(find("run-number").value) || 1) });
  });
  for (const until of ["certain", "converged"]) {
    find(`run-${until}`).addEventListener("click", () => {
      find("run-menu").hidePopover();
      run({ until });
    });
  }
  find("trouble-close").addEventListener("click", () => put({ trouble: "" }));
  on(["session", "rows", "lost", "trouble", "view"], show);
}

const iterates = () => ["running", "waiting"].includes(state.session?.state);

export function playOrPause() {
  if (isRecording()) return;
  if (iterates()) order("pause", {}, "Pause");
  else run({});
}

export function step() {
  if (isRecording() || iterates()) return;
  live();
  order("step", { iterations: 1 }, "Step");
}

function run(body) {
  live();
  order("run", body, "Run");
}

function live() {
  if (!isLive()) goTo(null);
}

async function order(verb, body) {
  try {
    // what came of it is told by the events, in order: the answer may come after a later state
    await call(`${root(state.id)}/${verb}`, { method: "POST", body });
    put({ trouble: "" });
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    put({ trouble: error.status === 0 ? "" : error.message, lost: error.status === 0 || state.lost });
  }
}

function show() {
  const session = state.session;
  if (!session) return;
  const here = session.state;
  const name = session.name || (isRecording() ? "Recording" : "Session") + " " + session.id;
  say(find("name"), name);
  find("name").title = name;
  document.title = `${name}: pmpnbp`;
  find("state").dataset.state = state.lost ? "lost" : here;
  say(find("state-word"), state.lost ? "connection lost" : word(session));

  const at = newest();
  const going = iterates();
  const total = going ? session.iterations : Math.max(at, 1);
  say(find("progress-number"), going ? `${at} of ${session.iterations}` : `${at}`);
  find("progress-bar").style.width = `${Math.min(100, (100 * at) / Math.max(1, total))}%`;
  find("certain").dataset.certain = String(Boolean(session.certain));
  say(find("certain"), session.certain ? "certain" : "not certain");

  const fixed = isRecording() || here === "deleted";
  for (const id of ["play", "step", "run-open", "reset"]) find(id).disabled = fixed || state.lost;
  find("buttons").hidden = isRecording();
  find("step").disabled ||= going;
  find("run-open").disabled ||= going;
  find("play").dataset.going = String(going);
  find("play").setAttribute("aria-label", going ? "Pause" : "Run");
  say(find("play-word"), going ? "Pause" : "Run");

  const trouble = state.lost
    ? "The connection to the server is lost. This page tries again by itself, and comes back to where it was."
    : session.error || state.trouble || state.view.error;
  find("trouble").hidden = !trouble;
  find("trouble").dataset.kind = state.lost ? "lost" : "error";
  find("trouble-close").hidden = state.lost || Boolean(session.error);
  say(find("trouble-text"), trouble ?? "");
}

function word(session) {
  if (session.state === "waiting" && session.position) return `waiting, number ${session.position} in line`;
  if (session.state === "paused" && session.converged) return "at rest";
  return WORDS[session.state] ?? session.state;
}
