// How do a standard deviation and a joint's interval look in a cell of a table? A text, and a thin bar under it.

import { h } from "./dom.js";
import { fineCentimetres, jointEnds, largest } from "./format.js";

// Of a standard deviation's bar, the share that is up to the limit; the rest is for what is over it.
const TO_LIMIT = 0.75;

// The posterior's largest standard deviation against the limit, metres, of what is certain or not.
export function stdGauge(stds, limit, certain) {
  const std = largest(stds);
  if (std === null) return "–";
  const share = limit > 0 ? std / limit : Infinity;
  const bar = { "--share": Math.min(1, share * TO_LIMIT), "--limit": TO_LIMIT };
  return [
    `±${fineCentimetres(std)}`,
    h("span", { class: "gauge", "data-certain": String(certain), css: bar, "aria-hidden": "true" }),
  ];
}

// The central 90 % of a joint within its limits, one line for each of its axes.
export function intervalGauge({ type, position, interval, lower, upper }) {
  if (interval === null) return "–";
  if (!Array.isArray(position)) return axisGauge(type, 0, position, interval, lower, upper);
  return position.map((at, axis) => h("div", {}, axisGauge(type, axis, at, interval[axis], lower[axis], upper[axis])));
}

function axisGauge(type, axis, position, interval, lower, upper) {
  const share = (value) => Math.min(1, Math.max(0, (value - lower) / (upper - lower)));
  const [from, to] = interval.map(share);
  const bar = { "--from": from, "--to": to, "--at": share(position) };
  // a floating joint's axes may have no ends to draw between
  const drawn = Number.isFinite(upper - lower) && upper > lower;
  return [
    jointEnds(type, interval, axis),
    drawn ? h("span", { class: "interval", css: bar, "aria-hidden": "true" }, h("span")) : null,
  ].filter(Boolean);
}
