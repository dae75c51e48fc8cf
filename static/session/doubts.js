// Why is a link not certain? The first of the server's reasons, in a sentence; that it may be elsewhere says more than that
// its deviation is large, which it then is.

import { degrees, fineCentimetres } from "./format.js";

// By how much a link may not be turned, radians for each metre of the limit (2° for 2.5 mm).
const TURN = (400 * Math.PI) / 90;

const SENTENCES = {
  fit: (_, { fit_reason: reason }) => reason,
  draws: (_, { effective_draws: draws }) => `the posterior rests on ${Math.round(draws)} effective draws only`,
  denied: () => "the scan sees through it, or what it hangs on: it may be elsewhere",
  outside_region: () => "the region of interest leaves it out, or what it hangs on: it may be elsewhere",
  alike: () => "it looks the same turned another way, and no look would tell which, see its hypotheses",
  std_xyz: (_, { max_std: limit }) => `its std is above ${fineCentimetres(limit)}`,
  expected_add: ({ expected_add: add }) => `expected to be off by ${fineCentimetres(add)} (ADD)`,
  elsewhere: () => "it may be elsewhere, see its hypotheses",
  turned: (_, { max_std: limit }) => `it may be turned by more than ${degrees(TURN * limit)}`,
};

export function doubts(link, estimate) {
  if (link.certain) return "";
  if (link.doubts === null) return "told once the inference is at rest";
  const [first] = link.doubts;
  const told = first === "std_xyz" && link.doubts.includes("elsewhere") ? "elsewhere" : first;
  return SENTENCES[told](link, estimate);
}
