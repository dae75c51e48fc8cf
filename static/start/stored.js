// Which models, scans and recordings are kept on the server? One list of each, asked for at the start and after each
// change, for all parts of the page.

import { call } from "../session/api.js";

export const KINDS = ["models", "scans", "recordings"];
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
