// What is believed about the part that was chosen? Its modes, and how the belief spreads along each coordinate.

import { call, root } from "./api.js";
import { histogram } from "./charts.js";
import { find, h, say } from "./dom.js";
import { degrees, measured, millimetres, percent, plural } from "./format.js";
import { colour, on, onTheme, partNamed, rowAt, shown, state } from "./state.js";
import { change } from "./view.js";
import { paced } from "./pace.js";

const BINS = 40;

export function install() {
  find("part-close").addEventListener("click", () => change({ part: null, particle: null }));
  find("part-why").addEventListener("click", () => find("tab-why").click());
  const draw = paced(drawn, () => `${state.view.part}@${shown()}`, (text) => {
    if (text) find("marginals").replaceChildren(h("p", { class: "calm" }, text));
  });
  on(["view", "rows", "estimate", "graph", "tab"], () => {
    const part = partNamed(state.view.part);
    if (!part || state.tab !== "estimate") return;
    head(part);
    draw();
  });
  onTheme(() => draw(true));
}

function head(part) {
  find("part-swatch").style.backgroundColor = colour(part);
  say(find("part-name"), part.name);
  const others = part.links.filter((link) => link !== part.name);
  say(find("part-links"), others.length ? `moves with ${others.join(", ")}` : "");
  const row = rowAt(shown());
  const effective = row?.effective[state.graph.parts.indexOf(part)];
  const link = state.estimate?.links[part.links[0]];
  say(find("part-facts"), [
    link ? `± ${millimetres(Math.max(...link.std_xyz))}` : null,
    link ? `${percent(link.visible_fraction)} visible` : null,
    Number.isFinite(effective) ? `${Math.round(effective)} effective` : null,
  ].filter(Boolean).join(" · "));
  if (link) modes(link.modes, part);
}

function modes(found, part) {
  say(find("modes-title"), plural(found.length, "mode"));
  find("modes").replaceChildren(...found.map(({ weight, pose: { position, orientation } }, at) =>
    h("li", {}, h("span", { class: "weight", css: { "--share": weight, "--tint": colour(part) }, "aria-hidden": "true" }),
      h("span", { class: "figure" }, percent(weight, found.length > 1 ? 1 : 0)),
      h("span", { class: "where" }, `(${[position.x, position.y, position.z].map((v) => (v * 100).toFixed(1)).join(", ")}) cm, ${degrees(2 * Math.acos(Math.min(1, Math.abs(orientation.w))))}`),
      at ? null : h("span", { class: "unseen" }, "the heaviest"))));
}

async function drawn() {
  const part = partNamed(state.view.part);
  if (!part) return;
  const link = encodeURIComponent(part.links[0]);
  const answer = await call(`${root(state.id)}/beliefs/${link}/marginals?iteration=${shown()}&bins=${BINS}`);
  if (state.view.part !== part.name) return;
  find("marginals").replaceChildren(...answer.marginals.map((one) => histogram({
    title: one.name.replace(/^joint /, ""), edges: one.edges, density: one.density, estimate: one.estimate,
    read: (value) => measured(value, one.unit), tint: colour(part),
  })));
}
