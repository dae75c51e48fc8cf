// Why is a link not certain, as far as a posterior tells? One sentence.

import { fineCentimetres, largest } from "./format.js";
import { hasPosterior } from "./state.js";

// A rival that weighs more may be where a link is not certain: what the server goes by.
const DOUBT = 0.01;

export function doubts(link, estimate) {
  if (link.certain) return "";
  if (!hasPosterior(estimate)) return "told once the inference is at rest";
  const limit = estimate.max_std;
  if (estimate.fit !== "good") return estimate.fit_reason;
  if (largest(link.std_xyz) > limit) return `its std is above ${fineCentimetres(limit)}`;
  if (link.expected_add > limit) return `expected to be off by ${fineCentimetres(link.expected_add)} (ADD)`;
  if (link.modes.filter((mode) => mode.weight > DOUBT).length > 1) return "it may be elsewhere, see its hypotheses";
  return `the posterior rests on ${Math.round(estimate.effective_draws)} effective draws only`;
}
