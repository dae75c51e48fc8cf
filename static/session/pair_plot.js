// What does the scan tie together? The posterior's draws in two coordinates of the object, a joint's position or a
// number of a link's pose, that two lists choose; drawn by pair_canvas.js. Asked for while it is open.

import { call, iterationQuery, linksQuery, sessionPath } from "./api.js";
import { byId, h, sentence } from "./dom.js";
import { DEGREES, number, percent, plural } from "./format.js";
import { MODE_COLOURS, paintPair } from "./pair_canvas.js";
import { hasPosterior, onTheme, state, subscribe } from "./state.js";
import { throttled } from "./throttle.js";

const POSE = ["x", "y", "z", "roll", "pitch", "yaw"];
// Of the draws' weight so much may lie beyond either end.
const BEYOND = 0.002;

let answer = null;
const chosen = { across: null, up: null }; // keys of coordinates, null: what the posterior leaves widest

export function install() {
  const ask = throttled(fetchDraws, key, sentence("pair-calm"));
  const update = () => {
    byId("pair").hidden = !hasPosterior(state.estimate);
    if (state.tab !== "belief" || byId("pair").hidden || !byId("pair").open) return;
    show();
    ask();
  };
  for (const axis of ["across", "up"]) {
    byId(`pair-${axis}`).addEventListener("change", (event) => {
      chosen[axis] = event.target.value;
      update();
    });
  }
  byId("pair").addEventListener("toggle", update);
  subscribe(["estimate", "view", "tab"], update);
  new ResizeObserver(show).observe(byId("pair-canvas"));
  onTheme(show);
}

const keyOf = ({ link, name }) => JSON.stringify([link, name]);
const label = ({ link, name }) => (link === null ? name.replace(/^joint /, "") : `${link} ${name}`);

// The links whose poses are needed: of what was chosen, and one for the lists to begin with.
function links() {
  const asked = Object.values(chosen).map((one) => one && JSON.parse(one)[0]);
  return [...new Set([Object.keys(state.estimate.links)[0], ...asked.filter(Boolean)])];
}

// While the inference stays at rest, so do the draws.
function key() {
  if (!hasPosterior(state.estimate)) return "";
  return [state.estimate.posterior_iteration, state.estimate.effective_draws, ...links()].join();
}

async function fetchDraws() {
  if (!hasPosterior(state.estimate)) return;
  const path = `${sessionPath(state.id)}/posterior${iterationQuery(state.estimate.iteration)}`;
  const found = await call(`${path}${linksQuery(links())}`);
  answer = { ...found, weights: found.log_weights.map((one) => (one === null ? 0 : Math.exp(one))) };
  show();
}

function show() {
  if (answer === null || answer.posterior_iteration !== state.estimate?.posterior_iteration) return; // on its way
  const known = new Map(answer.coordinates.map((one) => [keyOf(one), one]));
  const [first, second] = widest();
  const across = known.get(chosen.across ?? keyOf(first));
  const up = known.get(chosen.up ?? keyOf(second));
  if (!across || !up) return; // on its way
  options(byId("pair-across"), keyOf(across));
  options(byId("pair-up"), keyOf(up));
  const axes = [across, up].map(axisOf);
  const { weights, mode } = answer;
  paintPair(byId("pair-canvas"), axes, weights, mode);
  byId("pair-canvas").setAttribute("aria-label", told(axes, weights));
  const shares = state.estimate.alternatives.map((one) => one.weight);
  byId("pair-modes").replaceChildren(
    h("li", {}, h("span", { class: "cross", "aria-hidden": "true" }, "+"), "the estimate"),
    ...shares.map((share, at) =>
      h("li", {}, [
        h("span", { class: "swatch", css: { background: `var(${MODE_COLOURS[at]})` }, "aria-hidden": "true" }),
        shares.length > 1 ? `${percent(share, share < 0.1 ? 1 : 0)} alternative ${at + 1}` : "draws",
      ]),
    ),
  );
}

// The joints that are widest for their limits, else where the first link is.
function widest() {
  const share = ({ name }) => {
    const one = state.estimate.joints[name.replace(/^joint /, "")];
    return one && !Array.isArray(one.std) ? one.std / (one.upper - one.lower || 1) : 0;
  };
  const joints = answer.coordinates.filter((one) => one.link === null).sort((a, b) => share(b) - share(a));
  return [...joints, ...answer.coordinates.filter((one) => one.link !== null)];
}

function options(list, value) {
  const joints = answer.coordinates.filter((one) => one.link === null);
  const names = [joints.length, ...Object.keys(state.estimate.links)].join();
  if (list.dataset.names !== names) {
    list.dataset.names = names;
    const option = (one) => h("option", { value: keyOf(one) }, label(one));
    const group = (title, ones) => (ones.length ? h("optgroup", { label: title }, ones.map(option)) : null);
    const ofLinks = Object.keys(state.estimate.links).map((link) =>
      group(
        link,
        POSE.map((name) => ({ link, name })),
      ),
    );
    list.replaceChildren(...[group("joints", joints), ...ofLinks].filter(Boolean));
  }
  list.value = value;
}

// A coordinate in a unit that its spread is read in, with the ends between which its draws are.
function axisOf(coordinate) {
  const { values, estimate, unit } = coordinate;
  const [low, high] = ends(values, estimate);
  const [factor, word] = unit === "rad" ? [DEGREES, "°"] : [100, "cm"];
  const room = Math.max((high - low) * 0.06, 1e-5);
  return {
    title: `${label(coordinate)}, ${word}`,
    values: values.map((value) => value * factor),
    estimate: estimate * factor,
    low: (low - room) * factor,
    high: (high + room) * factor,
  };
}

function ends(values, estimate) {
  const order = values.map((_, at) => at).sort((a, b) => values[a] - values[b]);
  const inside = [];
  let below = 0;
  for (const at of order) {
    if (below + answer.weights[at] > BEYOND && below < 1 - BEYOND) inside.push(values[at]);
    below += answer.weights[at];
  }
  return [Math.min(estimate, ...inside.slice(0, 1)), Math.max(estimate, ...inside.slice(-1))];
}

// For who does not see the picture: how far either reaches, and how they go together.
function told([across, up], weights) {
  const mean = (values) => values.reduce((sum, value, at) => sum + weights[at] * value, 0);
  const centred = [across, up].map(({ values }) => values.map((value) => value - mean(values)));
  const [a, b] = centred;
  const moment = (one, other) => mean(one.map((value, at) => value * other[at]));
  const correlation = moment(a, b) / Math.sqrt(moment(a, a) * moment(b, b));
  const places = ({ low, high }) => (high - low < 1 ? 2 : 1);
  const reach = (axis) => `${axis.title}: ${number(axis.low, places(axis))} to ${number(axis.high, places(axis))}`;
  const together = Number.isFinite(correlation) ? `; correlation ${number(correlation, 2)}` : "";
  return `${plural(weights.length, "draw")} of the posterior; ${reach(across)}; ${reach(up)}${together}`;
}
