// What is drawn in the 3D view? A switch per layer, how points and particles are coloured, and the region and prior that
// can be dragged there, from which a new session can start.

import { button, find, h, say, segments } from "./dom.js";
import { DEGREES, number, percent } from "./format.js";
import { on, put, state } from "./state.js";
import { change } from "./view.js";
import { startAnother } from "./another.js";

const GROUPS = [
  ["Scan", [["scan", "points of the scan"], ["camera", "camera"], ["image", "depth image in the camera"], ["planes", "support planes"]]],
  ["Belief", [["particles", "particles"], ["axes", "axes of the best particles"], ["ellipsoids", "covariance ellipsoids"], ["messages", "messages of the chosen edge"]]],
  ["Object", [["estimate", "estimate"], ["truth", "truth"]]],
  ["To drag", [["region", "region of interest"], ["prior", "prior"]]],
];
const SCAN = [["depth", "depth"], ["explained", "explained"], ["plain", "plain"]];
const PARTICLES = [["part", "by part"], ["weight", "by weight"]];
const EXPLAINED = [["explained", "explained by the estimate"], ["occluding", "in front of it: occluding"], ["violated", "behind it: free space violated"], ["uncovered", "not covered by it"]];
const AXES = ["x", "y", "z"];

const boxes = new Map();

export function install() {
  for (const [title, layers] of GROUPS) {
    find("layer-groups").append(h("fieldset", {}, h("legend", {}, title), layers.map(([name, text]) => {
      const box = h("input", { type: "checkbox", role: "switch", id: `layer-${name}`, on: { change: () => change({ show: { [name]: box.checked } }) } });
      boxes.set(name, box);
      return h("label", { class: "switch", for: `layer-${name}` }, box, h("span", {}, text));
    })));
  }
  const [scan, showScan] = segments("Colour of the scan", SCAN, (value) => change({ colour_scan: value }));
  const [particles, showParticles] = segments("Colour of the particles", PARTICLES, (value) => change({ colour_particles: value }));
  find("colour-scan").append(scan);
  find("colour-particles").append(particles);
  find("explained-legend").append(...EXPLAINED.map(([name, text]) => h("li", { class: name }, h("span", { class: "swatch", "aria-hidden": "true" }), text)));
  find("confidence").addEventListener("input", (event) => change({ confidence: Number(event.target.value) / 100 }));
  AXES.forEach((axis, at) => find("region-numbers").append(h("div", {}, h("span", { class: "axis" }, axis),
    ends(at, `smallest ${axis} of the region, centimetres`), h("span", {}, "to"), ends(at + 3, `largest ${axis} of the region, centimetres`), h("span", { class: "unit" }, "cm"))));
  find("region-start").append(button("Start a new session with this region", () => another("region"), { class: "wide" }));
  find("prior-start").append(button("Start a new session with this prior", () => another("prior"), { class: "wide" }));
  on(["view", "graph"], () => show(showScan, showParticles));
}

function ends(at, label) {
  return h("input", { type: "number", step: "0.5", class: "region-number", "data-at": at, "aria-label": label, on: { change: region } });
}

function region(event) {
  const six = [...(state.view.region ?? state.session?.roi ?? [-0.5, -0.5, -0.5, 0.5, 0.5, 0.5])];
  six[Number(event.target.dataset.at)] = Number(event.target.value) / 100;
  change({ region: six });
}

async function another(kind) {
  const members = kind === "region" ? { roi: state.view.region ?? state.session.roi } : { prior: state.view.prior ?? state.session.prior };
  await startAnother(members, kind === "region" ? "another region" : "another prior", (text) => put({ trouble: text }));
}

function show(showScan, showParticles) {
  const view = state.view;
  for (const [name, box] of boxes) {
    box.checked = Boolean(view.show[name]);
    box.disabled = name === "truth" && !state.graph.truth;
    box.parentElement.title = box.disabled ? "the truth of this session is not known" : "";
  }
  showScan(view.colour_scan);
  showParticles(view.colour_particles);
  find("explained-legend").hidden = view.colour_scan !== "explained";
  if (document.activeElement !== find("confidence")) find("confidence").value = Math.round(view.confidence * 100);
  say(find("confidence-text"), `Ellipsoids hold ${percent(view.confidence)} of the position's distribution`);
  find("region").hidden = !view.show.region;
  find("prior").hidden = !view.show.prior;
  const six = view.region ?? state.session?.roi;
  for (const input of document.querySelectorAll(".region-number")) {
    if (document.activeElement !== input) input.value = six ? (six[input.dataset.at] * 100).toFixed(1) : "";
  }
  prior(view.prior ?? state.session?.prior);
}

function prior(given) {
  const place = find("prior-text");
  find("prior-start").firstChild.disabled = !given || given.kind !== "gaussian";
  if (!given || given.kind !== "gaussian") {
    say(place, "This session began without a prior pose: anywhere on the scan. The handle in the 3D view sets one.");
    return;
  }
  const { x, y, z } = given.pose.position;
  const of = (values, scale) => (Array.isArray(values) ? values : []).map((value) => number(value * scale, 1)).join(", ");
  say(place, `${given.link} at (${of([x, y, z], 100)}) cm, standard deviation (${of(given.std_xyz, 100)}) cm and (${of(given.std_rpy, DEGREES)})°`);
}
