// Several sessions side by side: a 3D view of each, and below it what it has found, in rows that all of them share.

import { call, sessionPath } from "../session/api.js";
import { byId, h, setText } from "../session/dom.js";
import { plural, stateWord } from "../session/format.js";
import { withoutGraphicsCard } from "../session/graphics.js";
import { onTheme, theme } from "../session/state.js";
import { trouble } from "../start/confirm.js";
import { showRows } from "./rows.js";
import { changeAll, openView } from "./views.js";

const MOST = 4; // sessions, as many as find place beside each other
const EVERY = 2000; // milliseconds between two questions

let timer = null;

begin();

async function begin() {
  const asked = new URLSearchParams(location.search).get("sessions") ?? "";
  const ids = [...new Set(asked.split(",").filter(Boolean))];
  const answers = await Promise.all(ids.slice(0, MOST).map((id) => told(id)));
  const columns = answers.filter((column) => column.session);
  const missing = answers.filter((column) => column.problem).map((column) => `${column.problem}.`);
  if (ids.length > MOST) missing.push(`${MOST} sessions find place here; ${ids.length - MOST} more were named.`);
  if (!ids.length) missing.push("No session is named: select some in the list of sessions.");
  trouble(byId("trouble"), missing.join(" "));
  if (columns.length) await show(columns);
  document.body.dataset.ready = "true";
}

// A session and its newest estimate, or why there is none.
async function told(id) {
  try {
    const session = await call(sessionPath(id));
    return { id, session, estimate: await newest(session) };
  } catch (problem) {
    return { id, problem: problem.message };
  }
}

const newest = ({ id, iteration }) => (iteration === null ? null : call(`${sessionPath(id)}/estimate`));

async function show(columns) {
  byId("across").hidden = false;
  byId("table").style.setProperty("--columns", columns.length);
  byId("together-row").hidden = columns.length < 2;
  for (const column of columns) byId("heads").append(head(column));
  fill(columns);
  onTheme(() => changeAll(appearance()));
  document.addEventListener("visibilitychange", () => {
    changeAll(appearance());
    refresh(columns);
  });
  timer = setTimeout(refresh, EVERY, columns);
  const economy = withoutGraphicsCard();
  await Promise.all(columns.map((column) => openView(column, { ...appearance(), economy }, turnedTogether)));
}

const turnedTogether = () => byId("together").checked;
const appearance = () => ({ theme: theme(), hidden: document.hidden });

function head(column) {
  column.name = h("a", { href: column.session.view_url });
  column.word = h("span", { class: "word" });
  column.frame = h("iframe");
  column.trouble = h("p", { class: "wrong" });
  const state = h("p", { class: "state" }, h("span", { class: "dot", "aria-hidden": "true" }), column.word);
  column.head = h("th", { scope: "col" }, column.name, state, column.frame, column.trouble);
  return column.head;
}

function fill(columns) {
  for (const { session, name, head: place, word, frame } of columns) {
    const called = session.name || "damaged session";
    setText(name, called);
    name.title = called;
    place.dataset.state = session.state;
    setText(word, stateWord(session));
    frame.title = `3D view of ${called}`;
  }
  const going = columns.filter(({ session }) => session.state === "running").length;
  setText(byId("summary"), `${plural(columns.length, "session")}, ${going} running`);
  showRows(byId("table"), columns);
}

async function refresh(columns) {
  clearTimeout(timer);
  if (document.hidden) return; // asks again when it is seen
  await Promise.all(columns.map(renew));
  fill(columns);
  clearTimeout(timer);
  timer = setTimeout(refresh, EVERY, columns);
}

// One that does not answer stays as it was, and says why.
async function renew(column) {
  try {
    const session = await call(sessionPath(column.id));
    const same = session.iteration === column.session.iteration && session.converged === column.session.converged;
    if (!same) column.estimate = await newest(session);
    column.session = session;
    setText(column.trouble, "");
  } catch (problem) {
    setText(column.trouble, problem.message);
  }
}
