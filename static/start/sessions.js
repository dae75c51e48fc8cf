// The list of sessions: asks /api/v1/sessions again and again while somebody looks, and shows what it answers.

import { call } from "../session/api.js";
import { byId, reconcile, setText } from "../session/dom.js";
import { fillCard, keepingFocus } from "./card.js";
import { trouble } from "./confirm.js";
import { isEdited } from "./edit.js";
import { chosen, filters } from "./query.js";
import * as selection from "./selection.js";
import { onChange } from "./stored.js";
import * as toolbar from "./toolbar.js";

const EVERY = 1500; // milliseconds between two questions; the picture's own pace is what a session's iterations give
const LATER = 5000; // after an answer that failed
const DRAWN = 60; // cards at first: nobody reads hundreds, and each change would look through all of them

let timer;
let questions = 0;
let lost = false;
let sessions = null; // as they were answered last
let ready = false; // whether the server's kernels are compiled
let all = false; // whether more than DRAWN were asked for

export function follow() {
  toolbar.install(show);
  selection.install(ask);
  onChange(show); // models, by whose names sessions are found
  byId("more").addEventListener("click", () => {
    all = true;
    show();
    byId("sessions").children[DRAWN]?.querySelector(".open").focus();
  });
  document.addEventListener("visibilitychange", () => document.hidden || ask());
  ask();
}

async function ask() {
  clearTimeout(timer);
  const question = ++questions;
  let pause = EVERY;
  try {
    const answer = await call("/api/v1/sessions");
    if (!answer.length && !ready) ready = (await call("/healthz")).ready;
    if (question !== questions) return; // asked once more meanwhile
    sessions = answer;
    show();
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

function show() {
  if (sessions === null) return;
  const fitting = chosen(sessions);
  const drawn = all ? fitting : fitting.slice(0, DRAWN);
  keepingFocus(() => reconcile(byId("sessions"), "card", withEdited(drawn), (session) => session.id, fill));
  byId("more").parentElement.hidden = drawn.length === fitting.length;
  setText(byId("more"), `Show all ${fitting.length}`);
  byId("empty").hidden = sessions.length > 0;
  byId("preparing").hidden = ready;
  const going = sessions.filter((session) => session.state === "running").length;
  const number = filters() ? `${fitting.length} of ${sessions.length} shown` : `${sessions.length} kept`;
  setText(byId("summary"), sessions.length ? `${number}, ${going} running` : "");
  toolbar.showToolbar(sessions, fitting);
  selection.showSelection(sessions, fitting);
}

// What somebody writes in stays, though it is not among those that are drawn any more.
function withEdited(drawn) {
  const edited = [...byId("sessions").children].filter(isEdited).map((card) => card.dataset.key);
  const left = sessions.filter((session) => edited.includes(session.id) && !drawn.includes(session));
  return [...drawn, ...left];
}

function fill(card, session) {
  fillCard(card, session, ask);
  card.querySelector(".delete").onclick = () => selection.forget([session]);
}
