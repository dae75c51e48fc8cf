// What does the page know, and who wants to hear of it? One object, and listeners by the members they look at.

export const state = {
  id: null, // of the session, or of the recording
  viewId: null, // of this tab's 3D view
  session: null, // as REST has it
  graph: { parts: [], edges: [], views: 1, truth: false },
  rows: [], // of the trace, by iteration, compact, not all of very many (see history.js)
  recalled: null, // a row that is not among them, looked at just now
  changes: [],
  view: {}, // what the 3D view shows; its members are the server's, see view.js
  estimate: null, // of the iteration that is looked at
  other: null, // the estimate it is compared with
  tab: "belief",
  lost: false, // whether the server was heard last time
  trouble: "", // a sentence about what did not work
  playback: false, // whether what is shown goes on by itself
};

const listeners = [];
const changed = new Set();
const PACE = 30; // milliseconds between two tellings
const ECONOMY = 1000; // the same where the processor draws the page, and iterates meanwhile
let timer = null;
let due = Infinity;
let last = -Infinity;

// Hear of it, soon and not too often, when any of the members has changed; and now.
export function subscribe(members, hear) {
  listeners.push([new Set(members), hear]);
  hear();
}

export function update(members) {
  Object.assign(state, members);
  notify(...Object.keys(members));
}

// Say that a member has changed in itself.
export function notify(...names) {
  for (const name of names) changed.add(name);
  const now = performance.now();
  const pace = state.view.economy && state.session?.state === "running" ? ECONOMY : PACE;
  const soon = Math.max(now, last + pace);
  if (due <= soon) return;
  // not with the next frame: where the 3D view is drawn without a GPU, frames are slow, and so would be the numbers
  clearTimeout(timer);
  due = soon;
  timer = setTimeout(notifyListeners, soon - now);
}

function notifyListeners() {
  due = Infinity;
  last = performance.now();
  const now = new Set(changed);
  changed.clear();
  for (const [members, hear] of listeners) if ([...now].some((name) => members.has(name))) hear();
}

// What follows from it

export const iterates = () => ["running", "waiting"].includes(state.session?.state);
export const isRecording = () => state.session?.kind === "recording";
export const isGone = () => state.session?.state === "deleted";
export const newestIteration = () => state.rows.at(-1)?.iteration ?? state.session?.iteration ?? 0;
export const oldestIteration = () => state.rows[0]?.iteration ?? 0;
export const isLive = () => state.view.iteration === null;
// Whether another iteration comes to be looked at by itself.
export const goesOn = () => state.playback || (isLive() && state.session?.state === "running");
// Whether settings or scans have changed since the newest iteration, which what is known of it does not take in.
export const isOutdated = () => state.changes.some((change) => change.after_iteration >= newestIteration());
export const shownIteration = () => (isLive() ? newestIteration() : Math.min(state.view.iteration, newestIteration()));
export const maxStd = () => state.session?.max_std ?? null;

// Whether an estimate says how sure it is, and whether it was read out for this page though not at rest.
export const hasPosterior = (estimate) => estimate !== null && estimate.posterior_iteration !== null;
export const askedFor = (estimate) => hasPosterior(estimate) && !estimate.converged;

// The trace's row of an iteration, or the last before it where it was not recorded.
export function rowAt(iteration) {
  if (state.recalled?.iteration === iteration) return state.recalled;
  const rows = state.rows;
  let low = 0;
  let high = rows.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (rows[middle].iteration <= iteration) low = middle;
    else high = middle - 1;
  }
  return rows[low] ?? null;
}

const dark = matchMedia("(prefers-color-scheme: dark)");
export const theme = () => (dark.matches ? "dark" : "light");
export const onTheme = (hear) => dark.addEventListener("change", hear);

export const partNamed = (name) => state.graph.parts.find((part) => part.name === name) ?? null;
export const colour = (part) => (dark.matches ? part?.colour_dark : part?.colour) ?? "currentcolor";
export const colourOf = (name) => colour(partNamed(name));
export const partOfLink = (link) => state.graph.parts.find((part) => part.links.includes(link)) ?? null;
