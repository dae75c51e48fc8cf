// What is drawn in the 3D view? A switch per layer, how points and particles are coloured, and the region and prior that
// can be dragged there, from which a new session can start.

import { startDerivedSession } from "./derived_session.js";
import { button, byId, h, segments, setText } from "./dom.js";
import { DEGREES, exact, number, percent } from "./format.js";
import { state, subscribe, update } from "./state.js";
import { changeView, choices, layers, legend } from "./view.js";

const AXES = ["x", "y", "z"];

const boxes = new Map();

export function install() {
  const groups = new Map();
  for (const [name, { title, group, description }] of Object.entries(layers())) {
    if (!groups.has(group)) groups.set(group, h("fieldset", {}, h("legend", {}, group)));
    groups.get(group).append(layerSwitch(name, title, description));
  }
  byId("layer-groups").append(...groups.values());
  const [scan, showScan] = segments("Colour of the scan", choices("colour_scan"), (value) =>
    changeView({ colour_scan: value }),
  );
  const [particles, showParticles] = segments(
    "Colour of the particles",
    choices("colour_particles"),
    (value) => changeView({ colour_particles: value }),
    (value) => `by ${value}`,
  );
  byId("colour-scan").append(scan);
  byId("colour-particles").append(particles);
  byId("explained-legend").append(
    ...legend("colour_scan").map(([name, colour]) =>
      h("li", {}, h("span", { class: "swatch", "aria-hidden": "true", css: { background: colour } }), name),
    ),
  );
  byId("confidence").addEventListener("input", (event) => changeView({ confidence: Number(event.target.value) / 100 }));
  for (const place of ["region-numbers", "setup-numbers"]) byId(place).append(...AXES.map(numbersOf));
  for (const [kind, member] of Object.entries({ region: "roi", prior: "prior" })) {
    const start = () => {
      const members = { [member]: state.view[kind] ?? state.session[member] };
      startDerivedSession(members, `another ${kind}`, (text) => update({ trouble: text }));
    };
    byId(`${kind}-start`).append(button(`Start a new session with this ${kind}`, start, { class: "wide" }));
  }
  subscribe(["view", "graph"], () => show(showScan, showParticles));
}

function layerSwitch(name, title, description) {
  const press = () => changeView({ show: { [name]: box.checked } });
  const box = h("input", { type: "checkbox", role: "switch", id: `layer-${name}`, on: { change: press } });
  boxes.set(name, box);
  return h("label", { class: "switch", for: `layer-${name}`, title: description }, box, h("span", {}, title));
}

function numbersOf(axis, at) {
  return h("div", {}, [
    h("span", { class: "axis" }, axis),
    ends(at, `smallest ${axis} of the region, centimetres`),
    h("span", {}, "to"),
    ends(at + 3, `largest ${axis} of the region, centimetres`),
    h("span", { class: "unit" }, "cm"),
  ]);
}

function ends(at, label) {
  const attributes = { type: "number", step: "0.5", class: "region-number", "data-at": at, "aria-label": label };
  return h("input", { ...attributes, on: { change: region } });
}

function region({ target }) {
  if (target.value === "") return;
  const six = [...(state.view.region ?? state.session?.roi ?? [-0.5, -0.5, -0.5, 0.5, 0.5, 0.5])];
  const at = Number(target.dataset.at);
  six[at] = Number(target.value) / 100;
  const [low, high] = [six[at % 3], six[(at % 3) + 3]];
  const ends = `from ${exact(low * 100)} to ${exact(high * 100)} cm`;
  say(low < high ? "" : `The region’s ${AXES[at % 3]} would go ${ends}; expected the smaller number first.`);
  if (low < high) changeView({ region: six });
}

let said = ""; // of numbers that make no region
function say(text) {
  if (text || (said && state.trouble === said)) update({ trouble: text });
  said = text;
}

function show(showScan, showParticles) {
  const view = state.view;
  for (const [name, box] of boxes) {
    box.checked = Boolean(view.show[name]);
    box.disabled = name === "truth" && !state.graph.truth;
    box.parentElement.title = box.disabled ? "the truth of this session is not known" : layers()[name].description;
  }
  showScan(view.colour_scan);
  showParticles(view.colour_particles);
  byId("explained-legend").hidden = view.colour_scan !== "explained";
  if (document.activeElement !== byId("confidence")) byId("confidence").value = Math.round(view.confidence * 100);
  setText(byId("confidence-text"), `Ellipsoids hold ${percent(view.confidence)} of the position's distribution`);
  byId("region").hidden = !view.show.region;
  byId("prior").hidden = !view.show.prior;
  const six = view.region ?? state.session?.roi;
  for (const input of document.querySelectorAll(".region-number")) {
    if (document.activeElement !== input) input.value = six ? (six[input.dataset.at] * 100).toFixed(1) : "";
  }
  prior(view.prior ?? state.session?.prior);
}

function prior(given) {
  const place = byId("prior-text");
  byId("prior-start").firstChild.disabled = !given || given.kind !== "gaussian";
  if (!given || given.kind !== "gaussian") {
    setText(
      place,
      "This session began without a prior pose: anywhere on the scan. The handle in the 3D view sets one.",
    );
    return;
  }
  const { x, y, z } = given.pose.position;
  const of = (values, scale) =>
    (Array.isArray(values) ? values : []).map((value) => number(value * scale, 1)).join(", ");
  setText(
    place,
    `${given.link} at (${of([x, y, z], 100)}) cm, standard deviation (${of(given.std_xyz, 100)}) cm and (${of(given.std_rpy, DEGREES)})°`,
  );
}
