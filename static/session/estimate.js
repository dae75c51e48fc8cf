// Where is every link, and how sure is that, given the scan? Tables of links, joints and what sensor and model have
// wrong, or the part or edge that was chosen.

import { showAlternatives } from "./alternatives.js";
import { byId, reconcile, sentence, setContent, setName, setText } from "./dom.js";
import { doubts } from "./doubts.js";
import { joint, millimetres, percent, plural } from "./format.js";
import { intervalGauge, stdGauge } from "./gauges.js";
import { choosePart } from "./graph.js";
import { sensorAndModel } from "./sensor_and_model.js";
import { colour, hasPosterior, onTheme, partOfLink, state, subscribe } from "./state.js";

const tellUnknown = sentence("unknown");

export function install() {
  subscribe(["estimate", "graph", "view"], show);
  onTheme(show);
}

function show() {
  const { part, edge } = state.view;
  byId("belief").hidden = Boolean(edge) && !part;
  byId("edge").hidden = !edge || Boolean(part);
  for (const id of ["all-links", "choose-calm"]) byId(id).hidden = Boolean(part);
  for (const id of ["part-heading", "part"]) byId(id).hidden = !part;
  if (!state.estimate) return;
  setText(byId("given-facts"), given(state.estimate));
  const facts = part ? [] : sensorAndModel(state.estimate);
  byId("sensor-title").hidden = !facts.length;
  reconcile(byId("sensor"), "sensor-row", facts, ([name]) => name, showFact);
  if (part || edge) return;
  reconcile(byId("links"), "link-row", Object.entries(state.estimate.links), ([name]) => name, showLink);
  tellUnknown(state.estimate.unknown.map((what) => `Not told by the scan: ${what}.`).join(" "));
  setText(byId("std-limit"), `of ${millimetres(state.estimate.max_std)}`);
  const joints = Object.entries(state.estimate.joints);
  byId("joints-title").hidden = !joints.length;
  reconcile(byId("joints"), "joint-row", joints, ([name]) => name, showJoint);
  showAlternatives(state.estimate);
}

// What all of it rests on.
function given({ posterior_iteration: iteration, effective_draws: draws }) {
  return iteration === null ? "" : `${plural(Math.round(draws), "effective draw")}, iteration ${iteration}`;
}

function showLink(row, [name, link]) {
  const part = partOfLink(name);
  row.querySelector("button").onclick = () => choosePart(part?.name ?? name);
  row.querySelector(".swatch").style.backgroundColor = colour(part);
  setName(row.querySelector(".long"), name);
  const [, std, visible, sure] = row.children;
  setContent(std, stdGauge(link.std_xyz, state.estimate.max_std));
  // what the standard deviation does not tell: how far off the whole link is expected to be
  std.title = link.expected_add === null ? "" : `expected to be off by ${millimetres(link.expected_add)} (ADD)`;
  setText(visible, percent(link.visible_fraction));
  setText(sure, link.certain ? "certain" : hasPosterior(state.estimate) ? "not certain" : "not yet");
  sure.dataset.certain = String(link.certain);
  sure.title = doubts(link, state.estimate);
}

function showJoint(row, [name, value]) {
  const [heading, position, interval] = row.children;
  setText(heading, name);
  heading.title = `${name}, ${value.type}`;
  setText(position, joint(value.type, value.position));
  setContent(interval, intervalGauge(value));
  interval.title = value.std === null ? "" : `std ${joint(value.type, value.std, 2)}`;
}

function showFact(row, texts) {
  for (const [place, cell] of [...row.children].entries()) setText(cell, texts[place]);
}
