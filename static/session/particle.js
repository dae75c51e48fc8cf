// Why does this particle weigh what it does? The best particles of a part, and of the chosen one its pose, where it came
// from, what the scan and each message give to its weight, and what the camera saw against what it would have seen.

import { call, sessionPath } from "./api.js";
import { bars } from "./charts.js";
import { button, byId, h, reconcile, sentence, setName, setText } from "./dom.js";
import { centimetres, joint, nats, number, percent } from "./format.js";
import { colour, colourOf, oldestIteration, onTheme, partNamed, shownIteration, state, subscribe } from "./state.js";
import { throttled } from "./throttle.js";
import { changeView } from "./view.js";

const LISTED = 24;
const PICTURE_PACE = 800; // milliseconds between two pictures
const SOURCES = { own: "own belief", neighbour: "a neighbour" };

const current = () => partNamed(state.view.part) ?? state.graph.parts[0] ?? null;
export const beliefs = (part) => `${sessionPath(state.id)}/beliefs/${encodeURIComponent(part.links[0])}`;
const currentKey = () => `${current()?.name}@${shownIteration()}`;

export function install() {
  const list = throttled(listParticles, currentKey, sentence("particles-calm"));
  const why = throttled(explainParticle, () => `${currentKey()}#${state.view.particle}`, sentence("why-calm"));
  const ask = () => {
    if (state.tab !== "why" || !current()) return;
    chips();
    byId("why").hidden = state.view.particle === null;
    byId("why-none").hidden = state.view.particle !== null;
    list();
    if (state.view.particle !== null) why();
    mark();
  };
  subscribe(["view", "rows", "graph", "tab"], ask);
  onTheme(ask);
  byId("why-view").addEventListener("change", picture);
  byId("why-enlarge").addEventListener("click", enlarge);
}

function chips() {
  reconcile(
    byId("why-parts"),
    "part-chip",
    state.graph.parts,
    (part) => part.name,
    (chip, part) => {
      chip.onclick = () => changeView({ part: part.name, edge: null, particle: null });
      chip.firstChild.style.backgroundColor = colour(part);
      setName(chip.lastChild, part.name);
      chip.setAttribute("aria-pressed", String(part === current()));
    },
  );
}

async function listParticles() {
  const part = current();
  const answer = await call(`${beliefs(part)}/particles?iteration=${shownIteration()}&limit=${LISTED}`);
  const most = answer.particles[0]?.weight || 1;
  reconcile(
    byId("particles"),
    "particle-row",
    answer.particles,
    (_, at) => at,
    (place, particle) => {
      const row = place.firstChild;
      const [index, weight, share, source] = row.children;
      Object.assign(row.dataset, { part: part.name, index: particle.index });
      // of the part that is listed, which need not be the one that was asked for since
      row.onclick = () => changeView({ part: part.name, edge: null, particle: particle.index });
      setText(index, `${particle.index}`);
      weight.style.setProperty("--share", particle.weight / most);
      weight.style.setProperty("--tint", colour(part));
      setText(share, percent(particle.weight, 2));
      setName(
        source,
        particle.neighbour ? `from ${particle.neighbour}` : (SOURCES[particle.source] ?? particle.source),
      );
    },
  );
  mark();
}

function mark() {
  for (const row of document.querySelectorAll("#particles .row")) {
    const { part, index } = row.dataset;
    row.setAttribute("aria-pressed", String(part === current().name && Number(index) === state.view.particle));
  }
}

async function explainParticle() {
  const part = current();
  if (state.view.particle === null) return;
  const answer = await call(`${beliefs(part)}/particles/${state.view.particle}?iteration=${shownIteration()}`);
  setText(byId("why-title"), `${part.name}, particle ${answer.index}`);
  setText(byId("why-weight"), `weight ${percent(answer.weight, 2)} · log weight ${nats(answer.log_weight, 2)}`);
  origin(answer);
  pose(answer);
  byId("why-shares").replaceChildren(bars(shares(answer)));
  picture();
}

function origin(answer) {
  const before = answer.iteration - 1;
  const { ancestor, ancestor_part: part } = answer;
  byId("why-origin").replaceChildren(h("p", {}, answer.origin));
  if (ancestor === null || before < oldestIteration()) return;
  const go = () => changeView({ iteration: before, part, edge: null, particle: ancestor });
  const text = `Particle ${ancestor} of ${part}, iteration ${before}`;
  byId("why-origin").append(button(text, go, { class: "link", id: "ancestor" }));
}

function pose(answer) {
  const p = answer.pose;
  const rows = [
    ["position", [p[0], p[1], p[2]].map((value) => centimetres(value)).join(", ")],
    ["quaternion", `w ${number(p[3], 3)}, x ${number(p[4], 3)}, y ${number(p[5], 3)}, z ${number(p[6], 3)}`],
  ];
  for (const [name, value] of Object.entries(answer.joint_positions ?? {})) {
    const known = state.estimate?.joints[name];
    rows.push([name, known ? joint(known.type, value) : number(value, 3)]);
  }
  byId("why-pose").replaceChildren(
    ...rows.map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", { class: "figure" }, value))),
  );
}

function shares(answer) {
  const { unary, messages, prior, constant } = answer.shares;
  const entries = [{ name: "the scan (unary)", value: unary }];
  for (const [name, value] of Object.entries(messages)) {
    entries.push({ name: `${name}’s message`, value, tint: colourOf(name) });
  }
  if (prior) entries.push({ name: "prior", value: prior });
  if (constant !== null) entries.push({ name: "common to all", value: constant, tint: "var(--quiet)" });
  entries.push({ name: "log weight", value: answer.log_weight, tint: "var(--ink)", total: true });
  return entries;
}

// The picture is asked for when it is of another particle than the one that is there, one at a time and not in a hurry,
// as it takes the server a while; its place stays as large.
let drawing = false;

function picture() {
  const part = current();
  if (!part || state.view.particle === null || drawing) return;
  const views = state.graph.views ?? 1;
  byId("why-view-row").hidden = views < 2;
  const choice = byId("why-view");
  if (choice.length !== views)
    choice.replaceChildren(...Array.from({ length: views }, (_, at) => h("option", { value: at }, `scan ${at + 1}`)));
  const source = `${beliefs(part)}/particles/${state.view.particle}/picture.png?iteration=${shownIteration()}&view=${choice.value || 0}&width=`;
  const image = byId("why-picture");
  if (image.dataset.source === source) return;
  const next = new Image();
  const done = (hidden) => {
    image.hidden = hidden;
    setTimeout(() => {
      drawing = false;
      if (state.tab === "why") picture();
    }, PICTURE_PACE);
  };
  drawing = true;
  image.dataset.source = source;
  next.onload = () => {
    image.alt = `Observed depth, depth rendered at particle ${state.view.particle} of ${part.name}, and their difference`;
    image.src = next.src;
    done(false);
  };
  next.onerror = () => done(true);
  next.src = `${source}720`;
}

function enlarge() {
  const image = byId("why-picture");
  if (image.hidden) return;
  byId("picture-large").src = `${image.dataset.source}1080`;
  byId("picture-large").alt = image.alt;
  byId("picture").showModal();
}
