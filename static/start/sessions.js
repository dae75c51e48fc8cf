// The list of sessions: asks /api/v1/sessions again and again while somebody looks, and shows what it answers.

import { call } from "../session/api.js";
import { byId, reconcile, setText } from "../session/dom.js";
import { stateWord } from "../session/format.js";
import { confirmed, trouble } from "./confirm.js";
import { grouped } from "./format.js";

const EVERY = 1500; // milliseconds between two questions; the picture's own pace is what a session's iterations give
const LATER = 5000; // after an answer that failed

let timer;
let questions = 0;
let lost = false;

export function follow() {
  document.addEventListener("visibilitychange", () => document.hidden || ask());
  ask();
}

async function ask() {
  clearTimeout(timer);
  const question = ++questions;
  let pause = EVERY;
  try {
    const sessions = await call("/api/v1/sessions");
    if (question !== questions) return; // asked once more meanwhile
    show(sessions);
    if (lost) trouble(byId("trouble"), "");
    lost = false;
  } catch (problem) {
    trouble(byId("trouble"), problem.status ? problem.message : "The server does not answer; this page tries again.");
    lost = true;
    pause = LATER;
  }
  clearTimeout(timer);
  if (!document.hidden) timer = setTimeout(ask, pause);
}

function show(sessions) {
  const newest = [...sessions].sort((a, b) => (a.created < b.created ? 1 : -1));
  reconcile(byId("sessions"), "card", newest, (session) => session.id, fill);
  byId("empty").hidden = newest.length > 0;
  const going = newest.filter((session) => session.state === "running").length;
  setText(byId("summary"), newest.length ? `${newest.length} kept, ${going} iterating` : "");
}

async function forget(id, name) {
  const text = `“${name}” stops after its present iteration. Its recording is removed from the server for good.`;
  if (!(await confirmed("Delete this session?", text))) return;
  try {
    await call(`/api/v1/sessions/${id}`, { method: "DELETE" });
  } catch (problem) {
    trouble(byId("trouble"), problem.message);
  }
  ask();
}

function verdict({ fit, certain }) {
  if (fit === "good") return certain ? "found, certain" : "found, not certain";
  return { doubtful: "doubtful", none: "not found" }[fit] ?? "not at rest yet";
}

const title = (session) => session.name || session.id;

function fill(card, session) {
  const part = (name) => card.querySelector(`.${name}`);
  card.dataset.state = session.state;
  part("open").href = session.view_url;
  setText(part("name"), title(session));
  setText(part("word"), stateWord(session, "done"));
  const done = session.state === "paused" && session.converged; // before all that were asked for
  const total = (done ? session.iteration : session.iterations) ?? 0;
  const iteration = session.iteration === null ? "none" : grouped(session.iteration);
  setText(part("iteration"), total && !done ? `${iteration} of ${grouped(total)}` : iteration);
  const share = total ? Math.min(1, (session.iteration ?? 0) / total) : 0;
  part("track").firstElementChild.style.width = `${100 * share}%`;
  part("certain").dataset.certain = Boolean(session.certain);
  part("certain").dataset.fit = session.fit ?? "";
  part("certain").title = session.fit_reason ?? "";
  setText(part("certain"), verdict(session));
  setText(part("method"), session.method === "particle_filter" ? "particle filter" : "belief propagation");
  part("error").hidden = !session.error;
  setText(part("error"), session.error ?? "");
  part("delete").onclick = () => forget(session.id, title(session));
  part("delete").setAttribute("aria-label", `Delete the session ${title(session)}`);
  part("delete").title = "Delete the session";
  picture(card, session);
}

// The next picture is loaded beside the one that is shown, one at a time, so that nothing flickers or piles up.
function picture(card, session) {
  const shown = `${session.id}@${session.iteration}`;
  if (card.loading || card.dataset.picture === shown || session.iteration == null) return;
  card.loading = true;
  const next = new Image();
  next.alt = `The estimate of ${session.name || "this session"}, drawn over its scan`;
  next.onload = () => {
    card.querySelector("img").replaceWith(next);
    card.dataset.picture = shown;
    card.loading = false;
  };
  next.onerror = () =>
    setTimeout(() => {
      card.loading = false;
    }, LATER);
  next.src = `/api/v1/sessions/${session.id}/estimate.png?width=640&iteration=${session.iteration}`;
}
