// Was the object found, and is that enough to act on? A line under the bar, about the session's newest iteration whatever
// is looked at: its names of links, and how much is explained, are in that iteration's estimate. While the page plays it
// keeps to what is shown, so that nobody hears the end before it.

import { call, sessionPath } from "./api.js";
import { byId, setText } from "./dom.js";
import { jointEnds, named, percent } from "./format.js";
import * as setup from "./setup.js";
import {
  isLive,
  isOutdated,
  isRecording,
  iterates,
  newestIteration,
  partNamed,
  partOfLink,
  rowAt,
  shownIteration,
  state,
  subscribe,
} from "./state.js";
import { throttled } from "./throttle.js";

// The share of a part that is visible below which it is unseen; one without a surface is not.
const UNSEEN = 0.01;

// A good fit's reason: a part that is seen through, or another thing of the same kind, comes after the share.
const AFTER_SHARE = /^the scan confirms \d+ % of what should be seen(.*)$/;

let asked = null; // the newest estimate, where another iteration is looked at

export function install() {
  byId("draw-box").addEventListener("click", setup.drawBox);
  const ask = throttled(fetchNewest, newestIteration);
  subscribe(["session", "rows", "view", "estimate", "graph", "changes"], () => {
    if (state.session?.fit === "good" && !isLive() && !state.playback && !newest()) ask();
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
  const behind = state.playback && shownIteration() < newestIteration();
  const [word, rest] = behind ? ["", capital(rowAt(shownIteration())?.phase ?? session.phase)] : sentence(session);
  const place = byId("certain");
  place.dataset.certain = String(Boolean(session.certain) && !behind);
  place.dataset.fit = behind ? "" : (session.fit ?? "");
  setText(byId("verdict-word"), word);
  setText(byId("verdict-rest"), rest);
  byId("draw-box").hidden = session.fit !== "none" || behind || !setup.canOpen();
}

const capital = (word) => word[0].toUpperCase() + word.slice(1);

// What it comes to in a word, and why.
function sentence({ state: here, phase, fit, fit_reason: reason, certain }) {
  if (here === "deleted")
    return ["", state.rows.length ? "What is shown is the last that was heard of it" : "Nothing is known of it"];
  if (fit === "none") return ["Not found:", `${reason}.`];
  if (fit === "doubtful") return ["Doubtful:", `${reason}.`];
  if (fit !== "good") {
    if (iterates()) return ["", capital(phase)];
    const newest = newestIteration();
    if (newest === 0) return ["", "Not begun yet"];
    const changed = `Scans or settings have changed since iteration ${newest}: run it to take them in.`;
    return ["", isOutdated() && !isRecording() ? changed : "Not at rest yet"];
  }
  const estimate = newest();
  const explained = estimate?.explained ?? null;
  const links = certain ? "All parts certain." : uncertain(estimate);
  const told = explained === null ? reason : `${percent(explained)} explained${AFTER_SHARE.exec(reason)?.[1] ?? ""}`;
  return ["Found:", `${told}${told.endsWith("?") ? "" : "."} ${links}`];
}

// The parts with a link that is not certain, by the name of one: links that move together are one thing. Of what is not
// seen at all it says between which ends its joint may be.
function uncertain(estimate) {
  const doubted = Object.entries(estimate?.links ?? {}).filter(([, link]) => !link.certain);
  if (!doubted.length) return "Not all parts certain.";
  const parts = new Map(doubted.map(([name, link]) => [partOfLink(name)?.name ?? name, link]));
  const names = [...parts.keys()];
  const unseen = names.filter((name) => (parts.get(name).visible_fraction ?? 1) < UNSEEN);
  const others = names.filter((name) => !unseen.includes(name));
  return [
    unseen.length ? `${named(unseen.map((name) => name + between(name, estimate)))} unseen.` : "",
    others.length ? `${named(others)} not certain.` : "",
  ]
    .filter(Boolean)
    .join(" ");
}

function between(part, { joints }) {
  const links = partNamed(part)?.links ?? [part];
  const joint = Object.values(joints).find(({ child }) => links.includes(child));
  const told = joint?.interval && !Array.isArray(joint.position);
  return told ? ` (${jointEnds(joint.type, joint.interval)})` : "";
}
