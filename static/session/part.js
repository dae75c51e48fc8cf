// What is believed about the part that was chosen? Its hypotheses given the scan; what the algorithm's particles do is in
// algorithm.js.

import { byId, h, setText } from "./dom.js";
import { doubts } from "./doubts.js";
import { DEGREES, degrees, fineCentimetres, largest, percent, plural } from "./format.js";
import { angle, distance } from "./pose.js";
import { colour, hasPosterior, onTheme, partNamed, state, subscribe } from "./state.js";
import { changeView } from "./view.js";

// Two hypotheses have a part in one place where they would be told as the same, metres and radians.
const SAME = 0.001;
const TURNED = 0.5 / DEGREES;

export function install() {
  byId("part-close").addEventListener("click", () => changeView({ part: null, particle: null }));
  const draw = () => {
    const part = partNamed(state.view.part);
    if (part && state.tab === "belief") show(part);
  };
  subscribe(["view", "estimate", "graph", "tab"], draw);
  onTheme(draw);
}

function show(part) {
  byId("part-swatch").style.backgroundColor = colour(part);
  setText(byId("part-name"), part.name);
  const others = part.links.filter((link) => link !== part.name);
  setText(byId("part-links"), others.length ? `moves with ${others.join(", ")}` : "");
  const link = state.estimate?.links[part.links[0]];
  setText(byId("part-facts"), link ? facts(link) : "");
  if (!link) return;
  setText(byId("part-doubt"), hasPosterior(state.estimate) ? verdict(part) : "");
  const modes = apart(link.modes);
  setText(byId("modes-title"), modes.length ? plural(modes.length, "hypothesis", "hypotheses") : "hypotheses");
  byId("modes-calm").hidden = modes.length > 0;
  showModes("modes", modes, part);
}

function facts({ std_xyz: std, expected_add: add, visible_fraction: visible }) {
  const known = [std ? `±\u202f${fineCentimetres(largest(std))}` : null, `${percent(visible)} visible`];
  if (add !== null) known.push(`expected to be off by ${fineCentimetres(add)} (ADD)`);
  return known.filter(Boolean).join(" · ");
}

function verdict(part) {
  const doubtful = part.links.find((link) => !state.estimate.links[link].certain);
  return doubtful ? `Not certain: ${doubts(state.estimate.links[doubtful], state.estimate)}.` : "Certain.";
}

// Hypotheses of the whole object may have a part in one place, and differ in others: that is one hypothesis of the part.
function apart(modes) {
  const found = [];
  for (const { weight, pose } of modes) {
    const known = found.find(
      (one) =>
        distance(one.pose.position, pose.position) < SAME && angle(one.pose.orientation, pose.orientation) < TURNED,
    );
    if (known) known.weight += weight;
    else found.push({ weight, pose });
  }
  return found.sort((one, other) => other.weight - one.weight);
}

function where({ pose: { position, orientation } }) {
  const turned = degrees(2 * Math.acos(Math.min(1, Math.abs(orientation.w))));
  return `(${[position.x, position.y, position.z].map((v) => (v * 100).toFixed(1)).join(", ")}) cm, ${turned}`;
}

// Hypotheses, or clusters among particles, in the list `place`.
export function showModes(place, modes, part) {
  byId(place).replaceChildren(
    ...modes.map((mode, at) =>
      h("li", {}, [
        h("span", { class: "weight", css: { "--share": mode.weight, "--tint": colour(part) }, "aria-hidden": "true" }),
        h("span", { class: "figure" }, percent(mode.weight, modes.length > 1 ? 1 : 0)),
        h("span", { class: "where" }, where(mode)),
        at ? null : h("span", { class: "unseen" }, "the heaviest"),
      ]),
    ),
  );
}
