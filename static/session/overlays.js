// What lies over the 3D view? Buttons for the places it can be looked at from, and a legend of what is drawn just now, as
// the server tells it.

import { byId, h, setContent } from "./dom.js";
import { state, subscribe } from "./state.js";
import { changeView } from "./view.js";

// Narrower windows have no room for an open legend.
const ROOMY = matchMedia("(min-width: 801px)");

const looks = () => [...byId("looks").children];

export function install() {
  for (const one of looks()) one.addEventListener("click", () => look(one.dataset.look));
  byId("scene-legend").open = ROOMY.matches;
  subscribe(["view"], show);
}

// Look from the place of that name, as it is now.
export const look = (name) => changeView({ look: name });

function show() {
  for (const one of looks()) one.setAttribute("aria-pressed", String(one.dataset.look === state.view.look));
  const lines = state.view.legend ?? [];
  byId("scene-legend").hidden = !lines.length;
  setContent(byId("scene-legend-lines"), lines.map(line));
}

function line({ text, sign, colours }) {
  const [near, far] = [colours[0] ?? "var(--quiet)", colours[1] ?? colours[0] ?? "var(--quiet)"];
  const mark = h("span", {
    class: "sign",
    "data-sign": sign,
    "aria-hidden": "true",
    css: { "--near": near, "--far": far },
  });
  return h("li", {}, mark, h("span", {}, text));
}
