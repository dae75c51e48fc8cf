// What do the algorithm's particles do? How far they spread, how many of them count and how they cluster, part by part, or
// for the part that was chosen in full; none of it says how sure the estimate is.

import { call } from "./api.js";
import { histogram } from "./charts.js";
import { byId, insteadOf, reconcile, setName, setText } from "./dom.js";
import { fineCentimetres, largest, measured, number, plural } from "./format.js";
import { showModes } from "./part.js";
import { beliefs } from "./particle.js";
import { colour, onTheme, partNamed, rowAt, shownIteration, state, subscribe } from "./state.js";
import { throttled } from "./throttle.js";

const BINS = 40;

let before = null; // the part that was chosen last

export function install() {
  byId("part-why").addEventListener("click", () => byId("tab-why").click());
  const draw = throttled(drawMarginals, () => `${state.view.part}@${shownIteration()}`, insteadOf("marginals"));
  const show = () => {
    const part = partNamed(state.view.part);
    if (state.tab !== "belief") return;
    if (state.view.part !== before) byId("algorithm").open = Boolean(part); // who chooses one wants to see all of it
    before = state.view.part;
    byId("all-particles").hidden = Boolean(part);
    byId("part-particles").hidden = !part;
    if (part) showPart(part, draw);
    else if (state.estimate) reconcile(byId("particle-parts"), "particles-row", state.graph.parts, name, showRow);
  };
  subscribe(["view", "rows", "estimate", "graph", "tab"], show);
  onTheme(() => {
    show();
    draw(true);
  });
}

const name = (part) => part.name;
const linkOf = (part) => state.estimate?.links[part.links[0]] ?? null;
const spread = (part) => fineCentimetres(largest(linkOf(part)?.particle_std_xyz));
const effective = (part) => rowAt(shownIteration())?.effective[state.graph.parts.indexOf(part)] ?? null;

function showRow(row, part) {
  const [heading, ...cells] = row.children;
  heading.firstElementChild.style.backgroundColor = colour(part);
  setName(heading.lastElementChild, part.name);
  const clusters = linkOf(part)?.particle_modes.length ?? null;
  for (const [at, text] of [`±${spread(part)}`, number(effective(part), 0), number(clusters, 0)].entries())
    setText(cells[at], text);
}

function showPart(part, draw) {
  const link = linkOf(part);
  const count = effective(part);
  const facts = [`particles ±\u202f${spread(part)}`, count === null ? null : `${number(count, 0)} effective`];
  setText(byId("particle-facts"), facts.filter(Boolean).join(" · "));
  if (link) {
    setText(byId("particle-modes-title"), `${plural(link.particle_modes.length, "cluster")} among the particles`);
    showModes("particle-modes", link.particle_modes, part);
  }
  draw();
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
