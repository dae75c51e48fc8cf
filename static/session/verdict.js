// Was the object found, and is that enough to act on? A line under the bar, about the session's newest iteration whatever
// is looked at: its names of links, and how much is explained, are in that iteration's estimate.

import { call, sessionPath } from "./api.js";
import { byId, setText } from "./dom.js";
import { named, percent } from "./format.js";
import { isLive, isRecording, newestIteration, partOfLink, searches, state, subscribe } from "./state.js";
import * as tabs from "./tabs.js";
import { throttled } from "./throttle.js";
import { changeView } from "./view.js";

let asked = null; // the newest estimate, where another iteration is looked at

export function install() {
  byId("draw-box").addEventListener("click", drawBox);
  const ask = throttled(fetchNewest, newestIteration);
  subscribe(["session", "rows", "view", "estimate", "graph"], () => {
    if (state.session?.fit === "good" && !isLive() && !newest()) ask();
    show();
  });
}

// The estimate of the newest iteration, where it is known.
const newest = () => [state.estimate, asked].find((one) => one?.iteration === newestIteration()) ?? null;

async function fetchNewest() {
  asked = await call(`${sessionPath(state.id)}/estimate`);
  show();
}

function show() {
  const session = state.session;
  if (!session) return;
  const [word, rest] = sentence(session);
  const place = byId("certain");
  place.dataset.certain = String(Boolean(session.certain));
  place.dataset.fit = session.fit ?? "";
  setText(byId("verdict-word"), word);
  setText(byId("verdict-rest"), rest);
  byId("draw-box").hidden = session.fit !== "none" || isRecording();
}

// What it comes to in a word, and why.
function sentence({ state: here, fit, fit_reason: reason, certain }) {
  if (here === "deleted") return ["", "Nothing is known of it"];
  if (fit === "none") return ["Not found:", `${reason}.`];
  if (fit === "doubtful") return ["Doubtful:", `${reason}.`];
  if (fit !== "good") {
    const searching = searches(state.rows.at(-1)) && ["running", "waiting"].includes(here);
    return ["", searching ? "Searching" : "Not at rest yet"];
  }
  const estimate = newest();
  const explained = estimate?.explained ?? null;
  const links = certain ? "All links certain." : uncertain(estimate);
  return ["Found:", `${explained === null ? reason : `${percent(explained)} explained`}. ${links}`];
}

// The parts with a link that is not certain; of links that move together one name is enough.
function uncertain(estimate) {
  const links = Object.entries(estimate?.links ?? {}).filter(([, link]) => !link.certain);
  const names = new Set(links.map(([name]) => partOfLink(name)?.name ?? name));
  return names.size ? `${named([...names])} not certain.` : "Not all links certain.";
}

// A box around the object is what the search lacks most often.
function drawBox() {
  changeView({ show: { region: true } });
  tabs.open("layers");
  byId("region").scrollIntoView({ block: "nearest" });
}
