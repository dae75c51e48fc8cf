// Which models, scans and recordings are kept on the server? One list of each, asked for at the start and after each
// change, for all parts of the page.

import { call } from "../session/api.js";
import { trouble } from "./confirm.js";

// In a session's address: it is to be asked where the object stands.
export const SETUP = "?setup";
const KINDS = ["models", "scans", "recordings"];
export const stored = { models: [], scans: [], recordings: [] };

const heard = new Set();
let asked = 0;
const answered = { models: 0, scans: 0, recordings: 0 }; // by which question what is in `stored` was told

// `hear` is called after each answer, and once the lists are there.
export function onChange(hear) {
  heard.add(hear);
}

export async function refresh(kinds = KINDS) {
  asked += 1;
  const question = asked;
  const lists = await Promise.all(kinds.map((kind) => call(`/api/v1/${kind}`).catch(() => null)));
  kinds.forEach((kind, place) => {
    // an answer that was long on its way does not know what has come since
    if (!lists[place] || question < answered[kind]) return;
    answered[kind] = question;
    stored[kind] = [...lists[place]].reverse(); // the newest first
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
    const body = members();
    if (query === SETUP) askAhead(body);
    const session = await call(`/api/v1/${path}`, { method: "POST", body });
    location.assign(session.view_url + query);
  } catch (problem) {
    trouble(place, problem.message);
  }
  button.disabled = false;
}

// What the new session's page asks for first takes the server as long as the browser takes to get there.
function askAhead({ model_id, scan_ids }) {
  const scans = scan_ids.map((id) => `scan_id=${id}`).join("&");
  fetch(`/api/v1/models/${model_id}/regions?${scans}`, { keepalive: true }).catch(() => {});
}
