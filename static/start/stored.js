// Which models, scans and recordings are kept on the server? One list of each, asked for at the start and after each
// change, for all parts of the page.

import { call, sessionPath } from "../session/api.js";
import { trouble } from "./confirm.js";

// In a session's address: it is to be asked where the object stands.
export const SETUP = "?setup";
const KINDS = ["models", "scans", "recordings"];
export const stored = { models: [], scans: [], recordings: [] };

const heard = new Set();

// `hear` is called after each answer, and once the lists are there.
export function onChange(hear) {
  heard.add(hear);
}

export async function refresh(kinds = KINDS) {
  const lists = await Promise.all(kinds.map((kind) => call(`/api/v1/${kind}`).catch(() => null)));
  kinds.forEach((kind, place) => {
    if (lists[place]) stored[kind] = [...lists[place]].reverse(); // the newest first
  });
  for (const hear of heard) hear(stored);
}

export async function remove(kind, id) {
  await call(`/api/v1/${kind}/${id}`, { method: "DELETE" });
  await refresh([kind]);
}

// Make a session of what `members` gives, and go to its page, with `query`; what goes wrong is said in `place`.
export async function openNew(path, members, button, place, query) {
  trouble(place, "");
  button.disabled = true;
  try {
    const session = await call(`/api/v1/${path}`, { method: "POST", body: members() });
    // what its page asks for first takes the server a while, and the browser takes as long to get there
    if (query === SETUP) fetch(`${sessionPath(session.id)}/regions`, { keepalive: true }).catch(() => {});
    location.assign(session.view_url + query);
  } catch (problem) {
    trouble(place, problem.message);
  }
  button.disabled = false;
}
