// How far apart are two poses? Their members as REST has them.

import { DEGREES } from "./format.js";

// Metres between two positions.
export const distance = (a, b) => Math.hypot(a.x - b.x, a.y - b.y, a.z - b.z);

// Radians between two orientations.
export function angle(a, b) {
  const dot = Math.abs(a.x * b.x + a.y * b.y + a.z * b.z + a.w * b.w);
  const between = 2 * Math.acos(Math.min(1, dot));
  return between * DEGREES < 0.02 ? 0 : between; // below that the cosine has no digits left
}
