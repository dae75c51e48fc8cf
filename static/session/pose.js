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

// A vector [x, y, z] turned by an orientation.
export function turned([x, y, z], { x: i, y: j, z: k, w }) {
  const [a, b, c] = [2 * (j * z - k * y), 2 * (k * x - i * z), 2 * (i * y - j * x)];
  return [x + w * a + j * c - k * b, y + w * b + k * a - i * c, z + w * c + i * b - j * a];
}
