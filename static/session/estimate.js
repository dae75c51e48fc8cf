// Where is every link, and how sure is that? Tables of links, joints and what sensor and model have wrong, or the part or
// edge that was chosen.

import { showAlternatives } from "./alternatives.js";
import { byId, reconcile, setName, setText } from "./dom.js";
import { joint, largest, millimetres, percent } from "./format.js";
import { intervalGauge, stdGauge } from "./gauges.js";
import { choosePart } from "./graph.js";
import { sensorAndModel } from "./sensor_and_model.js";
import { colour, hasPosterior, onTheme, partOfLink, state, subscribe } from "./state.js";

// A rival that weighs more may be where a link is not certain: what the server goes by.
const DOUBT = 0.01;

export function install() {
  subscribe(["estimate", "graph", "view"], show);
  onTheme(show);
}

function show() {
  const chosen = state.view.part || state.view.edge;
  byId("all-links").hidden = Boolean(chosen);
  byId("part").hidden = !state.view.part;
  byId("edge").hidden = !state.view.edge || Boolean(state.view.part);
  if (!state.estimate || chosen) return;
  reconcile(byId("links"), "link-row", Object.entries(state.estimate.links), ([name]) => name, showLink);
  setText(byId("std-limit"), `of ${millimetres(state.estimate.max_std)}`);
  const joints = Object.entries(state.estimate.joints);
  byId("joints-title").hidden = !joints.length;
  reconcile(byId("joints"), "joint-row", joints, ([name]) => name, showJoint);
  showAlternatives(state.estimate);
  const facts = sensorAndModel(state.estimate);
  byId("sensor-title").hidden = !facts.length;
  reconcile(byId("sensor"), "sensor-row", facts, ([name]) => name, showFact);
}

function showLink(row, [name, link]) {
  const part = partOfLink(name);
  row.querySelector("button").onclick = () => choosePart(part?.name ?? name);
  row.querySelector(".swatch").style.backgroundColor = colour(part);
  setName(row.querySelector(".long"), name);
  const [, std, visible, sure] = row.children;
  std.replaceChildren(...[stdGauge(link.std_xyz, state.estimate.max_std)].flat());
  std.title = spreads(link);
  setText(visible, percent(link.visible_fraction));
  setText(sure, link.certain ? "certain" : hasPosterior(state.estimate) ? "not certain" : "not yet");
  sure.dataset.certain = String(link.certain);
  sure.title = doubts(link, state.estimate);
}

// What the standard deviation does not tell: how far off the whole link is expected to be, and what is no uncertainty.
function spreads({ expected_add: add, particle_std_xyz: particles }) {
  const expected = add === null ? [] : [`expected to be off by ${millimetres(add)} (ADD)`];
  return [...expected, `particles ±${millimetres(largest(particles))}: the algorithm's, no uncertainty`].join("\n");
}

// Why a link is not certain, as far as a posterior tells.
function doubts(link, estimate) {
  if (link.certain) return "";
  if (!hasPosterior(estimate)) return "told once the inference is at rest";
  const limit = estimate.max_std;
  if (estimate.fit !== "good") return estimate.fit_reason;
  if (largest(link.std_xyz) > limit) return `its std is above ${millimetres(limit)}`;
  if (link.expected_add > limit) return `expected to be off by ${millimetres(link.expected_add)} (ADD)`;
  if (link.modes.filter((mode) => mode.weight > DOUBT).length > 1) return "it may be elsewhere, see its hypotheses";
  return `the posterior rests on ${Math.round(estimate.effective_draws)} effective draws only`;
}

function showJoint(row, [name, value]) {
  const [heading, position, interval] = row.children;
  setText(heading, name);
  heading.title = `${name}, ${value.type}`;
  setText(position, joint(value.type, value.position));
  interval.replaceChildren(...[intervalGauge(value)].flat());
  interval.title = value.std === null ? "" : `std ${joint(value.type, value.std, 2)}`;
}

function showFact(row, texts) {
  for (const [place, cell] of [...row.children].entries()) setText(cell, texts[place]);
}
