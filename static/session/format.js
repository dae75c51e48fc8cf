// How are numbers written? Lengths in centimetres, angles in degrees, always with the unit and with as many places as
// stay the same from iteration to iteration.

const MINUS = "\u2212";
const NARROW = "\u202f";

export const DEGREES = 180 / Math.PI;

export function number(value, places = 1) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = Math.abs(value).toFixed(places);
  return (value < 0 && Number(text) !== 0 ? MINUS : "") + text;
}

// A number in another unit; what is not known stays so, as null times a number is 0.
const scaled = (value, factor) => (value === null || value === undefined ? null : value * factor);
const withUnit = (text, unit, space = NARROW) => (text === "–" ? text : text + space + unit);

// How sure, or how far off: to a tenth of a millimetre. Without the unit, for where that stands elsewhere; and with it.
export const inFineCentimetres = (metres) => number(scaled(metres, 100), Math.abs(metres) >= 0.1 ? 1 : 2);
export const fineCentimetres = (metres) => withUnit(inFineCentimetres(metres), "cm");
export const centimetres = (metres, places = 1) => withUnit(number(scaled(metres, 100), places), "cm");
export const degrees = (radians, places = 1) => withUnit(number(scaled(radians, DEGREES), places), "°", "");
export const percent = (share, places = 0) => withUnit(number(scaled(share, 100), places), "%");
export const nats = (value, places = 1) => number(value, places);

// A joint's position by its type: metres for slides, radians for turns, lists for planar and floating ones.
export function joint(type, value, places = 1) {
  if (Array.isArray(value))
    return value.map((one, at) => (isAngle(type, at) ? degrees(one) : centimetres(one))).join(", ");
  if (value === null || value === undefined) return "–";
  return isAngle(type, 0) ? degrees(value, places) : centimetres(value, places);
}

// Both ends of an interval of the joint's axis `at`, with one unit, and places enough to tell them apart.
export function jointEnds(type, [low, high], at = 0) {
  const angle = isAngle(type, at);
  const factor = angle ? DEGREES : 100;
  const places = (high - low) * factor < 1 ? 2 : 1;
  const write = angle ? degrees : centimetres;
  return `${number(low * factor, places)} to ${write(high, places)}`;
}

function isAngle(type, at) {
  if (type === "revolute" || type === "continuous") return true;
  return (type === "planar" && at === 2) || (type === "floating" && at > 2);
}

// The unit that people read for one of the server's, and how many of it one of that is.
export function unitRead(unit) {
  if (unit === "m") return { word: "cm", factor: 100 };
  if (unit === "rad") return { word: "°", factor: DEGREES };
  return { word: unit, factor: 1 };
}
// Without the digits that a change of units adds.
export const exact = (value) => Number(value.toPrecision(9));

// A number with a unit of the server's ("m", "rad") as people read it.
export function measured(value, unit, places = 1) {
  if (unit === "m") return centimetres(value, places);
  if (unit === "rad") return degrees(value, places);
  return number(value, places);
}

// The largest of some numbers; null where they are not known.
export const largest = (values) => (values?.length ? Math.max(...values) : null);

// Up to two names, and how many more there are.
export function named(names) {
  const [first, second, ...others] = names;
  if (others.length) return `${first}, ${second} and ${plural(others.length, "other")}`;
  return second === undefined ? (first ?? "") : `${first} and ${second}`;
}

// The few digits of a round number, as at the ticks of an axis.
export const plain = (value) => String(Number(value.toPrecision(3))).replace("-", MINUS);

export function plural(count, one, many = `${one}s`) {
  return `${count} ${count === 1 ? one : many}`;
}

const METHODS = { pmpnbp: "belief propagation", particle_filter: "particle filter" };
export const methodWord = (method) => METHODS[method] ?? "–";

const STATES = { waiting: "waiting for a free place", failed: "stopped by an error", recorded: "recording" };

// What a session does.
export function stateWord({ state, phase, position, converged, reading_out: readingOut }) {
  if (state === "waiting" && position) return `waiting, number ${position} in line`;
  if (readingOut) return "reading out the posterior…";
  if (state === "running") return phase === "at rest" ? "at rest, going on" : phase;
  return state === "paused" && converged ? "at rest" : (STATES[state] ?? state);
}
