// What is believed about the part that was chosen? Its hypotheses given the scan; what the algorithm's particles do is in
// algorithm.js.

import { byId, h, setText } from "./dom.js";
import { doubts } from "./doubts.js";
import { degrees, fineCentimetres, largest, percent, plural } from "./format.js";
import { colour, hasPosterior, onTheme, partNamed, state, subscribe } from "./state.js";
import { changeView } from "./view.js";

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
  setText(
    byId("modes-title"),
    link.modes.length ? plural(link.modes.length, "hypothesis", "hypotheses") : "hypotheses",
  );
  byId("modes-calm").hidden = link.modes.length > 0;
  showModes("modes", link.modes, part);
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

// Hypotheses, or clusters among particles, in the list `place`.
export function showModes(place, modes, part) {
  byId(place).replaceChildren(
    ...modes.map(({ weight, pose: { position, orientation } }, at) =>
      h("li", {}, [
        h("span", { class: "weight", css: { "--share": weight, "--tint": colour(part) }, "aria-hidden": "true" }),
        h("span", { class: "figure" }, percent(weight, modes.length > 1 ? 1 : 0)),
        h("span", { class: "where" }, [
          `(${[position.x, position.y, position.z].map((v) => (v * 100).toFixed(1)).join(", ")}) cm, ${degrees(2 * Math.acos(Math.min(1, Math.abs(orientation.w))))}`,
        ]),
        at ? null : h("span", { class: "unseen" }, "the heaviest"),
      ]),
    ),
  );
}
