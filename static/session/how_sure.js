// How sure is an iteration that is not at rest? Nobody is told unasked, as reading the posterior out takes as long as
// some iterations; during the search there is none.

import { byId, setText } from "./dom.js";
import { readOutPosterior } from "./history.js";
import { askedFor, goesOn, hasPosterior, isGone, rowAt, shownIteration, state, subscribe, update } from "./state.js";
import { hold } from "./timeline.js";

let underway = false;

export function install() {
  byId("how-sure").addEventListener("click", ask);
  subscribe(["estimate", "rows", "recalled", "view", "session"], show);
}

async function ask() {
  const iteration = state.estimate.iteration;
  if (goesOn()) hold(iteration); // else it would be gone with the next one
  underway = true;
  show();
  try {
    await readOutPosterior(iteration);
  } catch (error) {
    update(error.status === 0 ? { lost: true } : { trouble: error.message });
  } finally {
    underway = false;
    show();
  }
}

function show() {
  const estimate = state.estimate;
  const row = rowAt(shownIteration());
  const lacks = estimate !== null && !hasPosterior(estimate);
  const searching = row?.phase === "searching";
  byId("how-sure").hidden = !lacks || searching || row === null;
  byId("how-sure").disabled = underway || isGone();
  setText(byId("how-sure"), underway ? "Reading it out…" : "How sure?");
  setText(byId("how-sure-text"), told(estimate, lacks, searching));
  byId("how-sure-text").hidden = !byId("how-sure-text").textContent;
}

function told(estimate, lacks, searching) {
  if (lacks) return searching ? "The search says nothing yet about how sure it is." : "Not at rest in this iteration.";
  if (!askedFor(estimate)) return "";
  return `Not at rest in iteration ${estimate.iteration}; read out all the same: ${estimate.fit_reason}.`;
}
