// What is believed about the part that was chosen? Its modes, and how the belief spreads along each coordinate.

import { call } from "./api.js";
import { histogram } from "./charts.js";
import { byId, h, insteadOf, setText } from "./dom.js";
import { degrees, largest, measured, millimetres, percent, plural } from "./format.js";
import { beliefs } from "./particle.js";
import { colour, onTheme, partNamed, rowAt, shownIteration, state, subscribe } from "./state.js";
import { throttled } from "./throttle.js";
import { changeView } from "./view.js";

const BINS = 40;

export function install() {
  byId("part-close").addEventListener("click", () => changeView({ part: null, particle: null }));
  byId("part-why").addEventListener("click", () => byId("tab-why").click());
  const draw = throttled(drawMarginals, () => `${state.view.part}@${shownIteration()}`, insteadOf("marginals"));
  subscribe(["view", "rows", "estimate", "graph", "tab"], () => {
    const part = partNamed(state.view.part);
    if (!part || state.tab !== "estimate") return;
    showHeading(part);
    draw();
  });
  onTheme(() => draw(true));
}

function showHeading(part) {
  byId("part-swatch").style.backgroundColor = colour(part);
  setText(byId("part-name"), part.name);
  const others = part.links.filter((link) => link !== part.name);
  setText(byId("part-links"), others.length ? `moves with ${others.join(", ")}` : "");
  const row = rowAt(shownIteration());
  const effective = row?.effective[state.graph.parts.indexOf(part)];
  const link = state.estimate?.links[part.links[0]];
  setText(
    byId("part-facts"),
    [
      link?.std_xyz ? `±\u202f${millimetres(largest(link.std_xyz))}` : null,
      link ? `${percent(link.visible_fraction)} visible` : null,
      link ? `particles ±\u202f${millimetres(largest(link.particle_std_xyz))}` : null,
      Number.isFinite(effective) ? `${Math.round(effective)} effective` : null,
    ]
      .filter(Boolean)
      .join(" · "),
  );
  if (!link) return;
  setText(
    byId("modes-title"),
    link.modes.length ? plural(link.modes.length, "hypothesis", "hypotheses") : "hypotheses",
  );
  byId("modes-calm").hidden = link.modes.length > 0;
  showModes("modes", link.modes, part);
  setText(byId("particle-modes-title"), `${plural(link.particle_modes.length, "cluster")} among the particles`);
  showModes("particle-modes", link.particle_modes, part);
}

function showModes(place, modes, part) {
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

async function drawMarginals() {
  const part = partNamed(state.view.part);
  if (!part) return;
  const answer = await call(`${beliefs(part)}/marginals?iteration=${shownIteration()}&bins=${BINS}`);
  if (state.view.part !== part.name) return;
  byId("marginals").replaceChildren(
    ...answer.marginals.map((one) =>
      histogram({
        ...one,
        title: one.name.replace(/^joint /, ""),
        read: (value) => measured(value, one.unit),
        tint: colour(part),
      }),
    ),
  );
}
