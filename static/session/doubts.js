// Why is a link not certain, as far as a posterior tells? One sentence.

import { degrees, fineCentimetres, largest } from "./format.js";
import { hasPosterior } from "./state.js";

// A rival that weighs more may be where a link is not certain: what the server goes by.
const DOUBT = 0.01;
// And fewer draws, and by how much a link may not be turned, radians for each metre of the limit (2° for 2.5 mm).
const FEWEST_DRAWS = 20;
const TURN = (400 * Math.PI) / 90;

export function doubts(link, estimate) {
  if (link.certain) return "";
  if (!hasPosterior(estimate)) return "told once the inference is at rest";
  const limit = estimate.max_std;
  if (estimate.fit !== "good") return estimate.fit_reason;
  if (largest(link.std_xyz) > limit) return `its std is above ${fineCentimetres(limit)}`;
  if (link.expected_add > limit) return `expected to be off by ${fineCentimetres(link.expected_add)} (ADD)`;
  if (link.modes.filter((mode) => mode.weight > DOUBT).length > 1) return "it may be elsewhere, see its hypotheses";
  if (estimate.effective_draws < FEWEST_DRAWS)
    return `the posterior rests on ${Math.round(estimate.effective_draws)} effective draws only`;
  return `it may be turned by more than ${degrees(TURN * limit)}`;
}
