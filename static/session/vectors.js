// Sums and turns of vectors, lists [x, y, z].

export const listed = ({ x, y, z }) => [x, y, z];
export const plus = (a, b, factor = 1) => a.map((one, axis) => one + factor * b[axis]);
export const minus = (a, b) => plus(a, b, -1);
export const dot = (a, b) => a.reduce((sum, one, axis) => sum + one * b[axis], 0);
export const cross = ([a, b, c], [d, e, f]) => [b * f - c * e, c * d - a * f, a * e - b * d];
export const unit = (a) => a.map((one) => one / (Math.hypot(...a) || 1));
export const mean = (all) => all.reduce((sum, one) => plus(sum, one, 1 / all.length), [0, 0, 0]);

// Turned by an orientation, with members as REST has them.
export function turned(a, { x, y, z, w }) {
  const aside = cross([x, y, z], a).map((one) => 2 * one);
  return plus(plus(a, aside, w), cross([x, y, z], aside));
}
