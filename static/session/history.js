// What has happened so far? The trace, its changes and the estimate of the iteration that is looked at, kept up to date
// by the session's events; when the connection breaks it is said, and all is asked for again once it is back.

import { call, iterationQuery, listen, Problem, sessionPath } from "./api.js";
import { largest } from "./format.js";
import { isGone, notify, rowAt, shownIteration, state, subscribe, update } from "./state.js";
import { goToIteration } from "./view.js";

const PACE = 200; // milliseconds between two estimates
const AGAIN = 1500; // milliseconds to the next try where the server was not heard, or gave no estimate
const EVERY = 1; // seconds between two lots of iterations, where the processor draws the page
const KEPT = 40; // estimates
const ROWS = 4000; // of the trace, at most: beyond it every second one is forgotten, so that a page can stay open for days
const CHANGE = 400; // milliseconds after which a changed session is asked for its changes

const estimates = new Map();
let closeEvents = null;

let retryTimer = null;
// While the server is not heard, ask again: not every call that fails breaks the events' connection.
function retry() {
  if (!state.lost || retryTimer) return;
  retryTimer = setTimeout(() => {
    retryTimer = null;
    load().catch(report).finally(retry);
  }, AGAIN);
}

// Load everything and listen; `sparing`, to iterations EVERY second only. Resolves after the first answer; rejects where
// there is no such session.
export async function follow(id, sparing) {
  state.id = id;
  await load();
  closeEvents?.();
  let before = true;
  closeEvents = listen(
    `${sessionPath(id)}/events${sparing ? `?every=${EVERY}` : ""}`,
    { iteration: hearIteration, state: hearState, error: hearState },
    {
      opened: () => {
        if (!before || state.lost) load().catch(report);
        before = false;
      },
      lost: () => update({ lost: true }),
      refused: sessionIsGone,
    },
  );
  subscribe(["lost"], retry);
}

async function load() {
  const id = state.id;
  const session = await call(sessionPath(id));
  const [graph, trace] = await Promise.all([
    call(`${sessionPath(id)}/graph`).catch(() => null),
    call(`${sessionPath(id)}/trace?limit=${ROWS}`).catch((error) =>
      session.state === "failed" ? { iterations: [] } : Promise.reject(error),
    ),
  ]);
  state.graph = graph ?? graphOfTrace(trace.iterations.at(-1));
  estimates.clear();
  const rows = trace.iterations.map(compact);
  update({ session, graph: state.graph, rows, recalled: null, changes: trace.changes ?? [], lost: false });
}

// Whether there is no such session any more, which is told, and ends all asking.
async function sessionIsGone() {
  if (isGone()) return true;
  try {
    await call(sessionPath(state.id));
    return false;
  } catch (error) {
    if (error.status !== 404) return false;
    closeEvents?.();
    update({
      lost: false,
      trouble: "This session is not here any more.",
      session: { ...state.session, state: "deleted", certain: false, fit: null },
    });
    return true;
  }
}

async function report(error) {
  if (error instanceof Problem && error.status === 0) update({ lost: true });
  else if (error.status !== 404 || !(await sessionIsGone())) update({ trouble: error.message });
}

// Without the graph parts are known by the trace alone.
function graphOfTrace(row) {
  const names = Object.keys(row?.effective_sample_size ?? {});
  return {
    parts: names.map((name) => ({ name, links: [name], colour: null, colour_dark: null })),
    edges: [],
    views: 1,
    truth: false,
  };
}

// A row by part, in the graph's order: a long session has many of them.
function compact(row) {
  const parts = state.graph.parts;
  const ofParts = (stds) => parts.map((part) => largest(part.links.flatMap((link) => stds?.[link] ?? [])));
  return {
    iteration: row.iteration,
    phase: row.phase,
    seconds: row.seconds,
    elapsed: row.elapsed,
    finalLikelihood: row.final_log_likelihood, // of all iterations at one tolerance
    std: ofParts(row.std_xyz), // the posterior's: null where there is none
    particleStd: ofParts(row.particle_std_xyz),
    effective: parts.map((part) => row.effective_sample_size?.[part.name] ?? null),
    add: row.add ? parts.map((part) => row.add[part.name] ?? null) : null,
    certain: row.certain_by_link ? parts.map((part) => part.links.every((link) => row.certain_by_link[link])) : null,
    fit: row.fit,
    converged: row.converged,
    notes: row.notes?.length ? row.notes : null,
  };
}

function hearIteration(row) {
  const last = state.rows.at(-1)?.iteration ?? -1;
  if (row.iteration <= last) {
    if (row.iteration !== 0 && rowAt(row.iteration)?.iteration === row.iteration && row.iteration === last) return;
    state.rows = state.rows.filter((old) => old.iteration < row.iteration); // it began anew
    estimates.clear();
    state.estimate = state.recalled = null;
    if (state.view.iteration !== null && state.view.iteration > row.iteration) goToIteration(null);
    refreshChanges();
  } else if (row.iteration > last + 1 && last >= 0) {
    fetchMissed(last);
    return;
  }
  appendRows(row);
  const { iteration, phase, converged, certain, fit, fit_reason } = row;
  if (state.session) Object.assign(state.session, { iteration, phase, converged, certain, fit, fit_reason });
  if (state.lost) state.lost = false;
  notify("rows", "session", "lost", "view");
}

function appendRows(...rows) {
  state.rows.push(...rows.map(compact));
  while (state.rows.length > ROWS) state.rows = state.rows.filter((_, at, all) => (all.length - 1 - at) % 2 === 0);
}

let missed = null;
async function fetchMissed(after) {
  if (missed) return;
  missed = call(`${sessionPath(state.id)}/trace?after=${after}&limit=${ROWS}`)
    .then((trace) => {
      const known = state.rows.at(-1)?.iteration ?? -1;
      appendRows(...trace.iterations.filter((row) => row.iteration > known));
      notify("rows", "session");
    })
    .catch(report)
    .finally(() => {
      missed = null;
    });
}

function hearState(progress) {
  if (!state.session) return;
  Object.assign(state.session, progress);
  notify("session");
  refreshChanges();
}

let refreshing = null;
// Settings or scans may have been changed, here or elsewhere: which, and after which iteration, is in the trace.
function refreshChanges() {
  clearTimeout(refreshing);
  refreshing = setTimeout(async () => {
    try {
      const [{ config, scan_ids }, { changes }] = await Promise.all([
        call(sessionPath(state.id)),
        call(`${sessionPath(state.id)}/trace?after=${state.rows.at(-1)?.iteration ?? -1}`),
      ]);
      // how far it has come is told by the events alone: this answer may be older than the newest of them
      Object.assign(state.session, { config, scan_ids });
      if (scan_ids.length) state.graph.views = scan_ids.length; // a recording has no ids
      notify("session");
      update({ changes: changes ?? [] });
    } catch (error) {
      report(error);
    }
  }, CHANGE);
}

// The row of an iteration, where the page has forgotten it; else null.
async function fetchForgotten(iteration) {
  if (rowAt(iteration)?.iteration === iteration) return null;
  const { iterations } = await call(`${sessionPath(state.id)}/trace?after=${iteration - 1}&last=${iteration}`);
  return iterations.length ? compact(iterations[0]) : null;
}

let pause = null;
let asking = false;
// Have `state.estimate` be that of the iteration that is looked at, soon; not while nobody looks.
export function refreshEstimate() {
  if (pause || asking || document.hidden || isGone()) return;
  const iteration = shownIteration();
  if (state.estimate?.iteration === iteration) return;
  const known = estimates.get(iteration);
  if (known) {
    update(known);
    return;
  }
  asking = true;
  let next = PACE;
  Promise.all([call(`${sessionPath(state.id)}/estimate${iterationQuery(iteration)}`), fetchForgotten(iteration)])
    .then(([estimate, row]) => keep(row ? { estimate, recalled: row } : { estimate }))
    .catch((error) => {
      next = AGAIN;
      if (error.status === 0) update({ lost: true });
      // an iteration may have gone with a reset, and comes again
      else if (error.status === 404) return sessionIsGone();
    })
    .finally(() => {
      asking = false;
      pause = setTimeout(() => {
        pause = null;
        refreshEstimate();
      }, next);
    });
}

function keep(entry) {
  const { iteration } = entry.estimate;
  estimates.delete(iteration); // the newest stands last
  estimates.set(iteration, entry);
  if (estimates.size > KEPT) estimates.delete(estimates.keys().next().value);
  update(entry);
}

// Have the posterior of an iteration read out though the inference is not at rest there, and show it.
export async function readOutPosterior(iteration) {
  const estimate = await call(`${sessionPath(state.id)}/estimate${iterationQuery(iteration)}&posterior=true`);
  const entry = { ...estimates.get(iteration), estimate };
  if (shownIteration() === iteration) keep(entry);
}
