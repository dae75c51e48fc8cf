// Which sessions are listed, and in what order? The address says, so that a list can be sent and the back button works.

import { stored } from "./stored.js";

// What people call what was found, by the member of the address; also the order from the best to what is not known yet.
export const VERDICTS = {
  certain: "found, certain",
  found: "found, not certain",
  doubtful: "doubtful",
  none: "not found",
  open: "not at rest yet",
};
export const STATES = {
  running: "running",
  waiting: "waiting",
  failed: "stopped by an error",
  paused: "paused",
  rest: "at rest",
};

export function verdictOf({ fit, certain }) {
  if (fit === "good") return certain ? "certain" : "found";
  return fit ?? "open";
}
export const verdictWord = (session) =>
  verdictOf(session) === "open" && session.iteration === 0 ? "not begun yet" : VERDICTS[verdictOf(session)];

const stateOf = ({ state, converged }) => (state === "paused" && converged ? "rest" : state);

const newestFirst = (a, b) => (a.created === b.created ? 0 : (a.created ?? "") < (b.created ?? "") ? 1 : -1);
const names = new Intl.Collator("en", { numeric: true, sensitivity: "base" });
const inOrderOf = (words, word) => (a, b) => Object.keys(words).indexOf(word(a)) - Object.keys(words).indexOf(word(b));
const ORDERS = {
  newest: newestFirst,
  oldest: (a, b) => newestFirst(b, a),
  name: (a, b) => names.compare(a.name ?? "", b.name ?? ""),
  verdict: inOrderOf(VERDICTS, verdictOf),
  state: inOrderOf(STATES, stateOf),
  iterations: (a, b) => (b.iteration ?? -1) - (a.iteration ?? -1),
};

// q : words, all of which are in name, model or tags; tags : all of which it has; verdict, state : "" for any
export const query = { q: "", verdict: "", state: "", tags: [], sort: "newest" };

export function readAddress() {
  const asked = new URLSearchParams(location.search);
  const one = (name, known, otherwise = "") =>
    Object.hasOwn(known, asked.get(name) ?? "") ? asked.get(name) : otherwise;
  query.q = asked.get("q") ?? "";
  query.verdict = one("verdict", VERDICTS);
  query.state = one("state", STATES);
  query.sort = one("sort", ORDERS, "newest");
  query.tags = [...new Set(asked.getAll("tag"))];
}

// `step` : one that the back button undoes; typing is none
export function writeAddress(step) {
  const asked = new URLSearchParams();
  for (const name of ["q", "verdict", "state"]) if (query[name]) asked.set(name, query[name]);
  for (const tag of query.tags) asked.append("tag", tag);
  if (query.sort !== "newest") asked.set("sort", query.sort);
  const address = location.pathname + (asked.size ? `?${asked}` : "") + location.hash;
  if (address === location.pathname + location.search + location.hash) return;
  history[step ? "pushState" : "replaceState"](null, "", address);
}

export const filters = () => Boolean(query.q.trim() || query.verdict || query.state || query.tags.length);

export function chosen(sessions) {
  const models = new Map(stored.models.map((model) => [model.id, model.name]));
  const words = query.q.toLowerCase().split(/\s+/).filter(Boolean);
  const fits = (session) => {
    if (query.verdict && verdictOf(session) !== query.verdict) return false;
    if (query.state && stateOf(session) !== query.state) return false;
    if (!query.tags.every((tag) => session.tags.includes(tag))) return false;
    const text = [session.name, models.get(session.model_id), ...session.tags].join("\n").toLowerCase();
    return words.every((word) => text.includes(word));
  };
  // equal ones stay in the order that they were in
  return sessions.filter(fits).sort(newestFirst).sort(ORDERS[query.sort]);
}

// Every tag with the number of sessions that have it, by name.
export function tagCounts(sessions) {
  const counts = new Map();
  for (const { tags } of sessions) for (const tag of tags) counts.set(tag, (counts.get(tag) ?? 0) + 1);
  return [...counts].sort(([a], [b]) => names.compare(a, b));
}
