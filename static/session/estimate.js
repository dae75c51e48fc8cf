// Where is every part, and how sure is that, given the scan? Tables of parts, joints and what sensor and model have
// wrong, or the part or edge that was chosen. Links that are fixed to each other are one part, and one row.

import { showAlternatives } from "./alternatives.js";
import { byId, reconcile, sentence, setContent, setName, setText } from "./dom.js";
import { doubts } from "./doubts.js";
import { fineCentimetres, joint, largest, percent, plural } from "./format.js";
import { intervalGauge, stdGauge } from "./gauges.js";
import { choosePart } from "./graph.js";
import { sensorAndModel } from "./sensor_and_model.js";
import {
  colour,
  hasPosterior,
  isOutdated,
  newestIteration,
  onTheme,
  shownIteration,
  state,
  subscribe,
} from "./state.js";

const tellUnknown = sentence("unknown");
const tellOutdated = sentence("outdated");

export function install() {
  subscribe(["estimate", "graph", "view"], show);
  subscribe(["estimate", "view", "rows", "changes"], showOutdated);
  onTheme(show);
}

function show() {
  const { part, edge } = state.view;
  byId("belief").hidden = Boolean(edge) && !part;
  byId("edge").hidden = !edge || Boolean(part);
  for (const id of ["all-parts", "choose-calm"]) byId(id).hidden = Boolean(part);
  for (const id of ["part-heading", "part"]) byId(id).hidden = !part;
  if (!state.estimate) return;
  setText(byId("given-facts"), given(state.estimate));
  const facts = part ? [] : sensorAndModel(state.estimate);
  byId("sensor-title").hidden = !facts.length;
  reconcile(byId("sensor"), "sensor-row", facts, ([name]) => name, showFact);
  if (part || edge) return;
  reconcile(byId("part-rows"), "link-row", state.graph.parts, (one) => one.name, showPart);
  tellUnknown(state.estimate.unknown.map((what) => `Not told by the scan: ${what}.`).join(" "));
  setText(byId("std-limit"), `of ${fineCentimetres(state.estimate.max_std)}`);
  const joints = Object.entries(state.estimate.joints);
  byId("joints-title").hidden = !joints.length;
  reconcile(byId("joints"), "joint-row", joints, ([name]) => name, showJoint);
  showAlternatives(state.estimate);
}

// That scans or settings have changed is told while the newest iteration is looked at: of the others it is no news.
function showOutdated() {
  const shown = shownIteration();
  const before = isOutdated() && shown === newestIteration() && shown > 0;
  tellOutdated(before ? `This is of before the change: iteration ${shown} had other scans or settings.` : "");
}

// What all of it rests on.
function given({ posterior_iteration: iteration, effective_draws: draws }) {
  return iteration === null ? "" : `${plural(Math.round(draws), "effective draw")}, iteration ${iteration}`;
}

function showPart(row, part) {
  const estimate = state.estimate;
  const links = part.links.map((name) => estimate.links[name]).filter(Boolean);
  if (!links.length) return; // of a model that was another before the session began again
  const widest = links.reduce((most, link) => (largest(link.std_xyz) > largest(most.std_xyz) ? link : most));
  const off = largest(links.map((link) => link.expected_add).filter((add) => add !== null));
  const doubted = links.find((link) => !link.certain);
  row.querySelector("button").onclick = () => choosePart(part.name);
  row.querySelector(".swatch").style.backgroundColor = colour(part);
  setName(row.querySelector(".long"), part.name);
  const others = part.links.filter((name) => name !== part.name);
  const more = row.querySelector(".more");
  setText(more, others.length ? `+${others.length}` : "");
  more.title = others.length ? `moves with ${others.join(", ")}` : "";
  const [, std, visible, sure] = row.children;
  setContent(std, stdGauge(widest.std_xyz, estimate.max_std, !doubted));
  // what the standard deviation does not tell: how far off the whole part is expected to be
  std.title = off === null ? "" : `expected to be off by ${fineCentimetres(off)} (ADD)`;
  setText(visible, percent(links[0].visible_fraction));
  setText(sure, !doubted ? "certain" : hasPosterior(estimate) ? "not certain" : "not yet");
  sure.dataset.certain = String(!doubted);
  sure.title = doubted ? doubts(doubted, estimate) : "";
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
