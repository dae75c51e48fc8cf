// What hangs on what? The Markov random field as a drawing: a node per part with a ring that closes as it becomes
// certain, an edge per pair of parts that joints connect.

import { byId, s, setAttributes, setText } from "./dom.js";
import { fineCentimetres, largest } from "./format.js";
import { colour, maxStd, onTheme, rowAt, shownIteration, state, subscribe } from "./state.js";
import { changeView } from "./view.js";

const WIDTH = 348;
const RADIUS = 11;
const RING = 15;
const AROUND = 2 * Math.PI * RING;
const OPEN = 0.82; // share of a ring that has not closed, at the most: its round ends take more
// Between two rows of a deep tree a letter that is so far beside a node lies under no ring.
const CLEAR = 12;
const LETTER = 5.5; // the width of an edge's letters there

const nodes = new Map();
const edges = [];

export function install() {
  subscribe(["graph"], build);
  subscribe(["graph", "rows", "recalled", "view", "estimate"], show);
  onTheme(show);
}

// Choose a part; a second time lets it go.
export function choosePart(name) {
  changeView({ part: state.view.part === name ? null : name, edge: null, particle: null });
}

function chooseEdge(parent, child) {
  const same = state.view.edge?.[0] === parent && state.view.edge?.[1] === child;
  changeView({ edge: same ? null : [parent, child], part: null, particle: null, show: { messages: !same } });
}

// Where the parts stand: leaves side by side, parents over the middle of their children, a row per generation.
export function layout({ parts, edges: pairs }) {
  const children = new Map(parts.map((part) => [part.name, []]));
  const roots = new Set(parts.map((part) => part.name));
  for (const { parent, child } of pairs) {
    children.get(parent)?.push(child);
    roots.delete(child);
  }
  const placed = new Map();
  let leaves = 0;
  const walk = (name, depth) => {
    if (placed.has(name)) return placed.get(name).column;
    placed.set(name, { depth, column: 0 });
    const below = children.get(name).map((child) => walk(child, depth + 1));
    const column = below.length ? (Math.min(...below) + Math.max(...below)) / 2 : leaves++;
    placed.get(name).column = column;
    return column;
  };
  for (const name of roots) walk(name, 0);
  const depth = Math.max(0, ...[...placed.values()].map((place) => place.depth));
  return { placed, leaves: Math.max(1, leaves), depth };
}

function build() {
  const drawing = byId("graph");
  drawing.replaceChildren();
  nodes.clear();
  edges.length = 0;
  const { placed, leaves, depth } = layout(state.graph);
  // a deep tree has its names beside the nodes, where a chain leaves room for them
  const deep = depth > 3;
  const row = deep ? 38 : depth > 1 ? 70 : 84;
  const height = (deep ? 44 : 62) + depth * row;
  setAttributes(drawing, { viewBox: `0 0 ${WIDTH} ${height}`, "data-deep": String(deep) });
  const column = WIDTH / leaves;
  const x = (name) => (deep ? 40 + placed.get(name).column * column : (placed.get(name).column + 0.5) * column);
  const y = (name) => 24 + placed.get(name).depth * row;

  for (const edge of state.graph.edges) {
    if (!placed.has(edge.parent) || !placed.has(edge.child)) continue;
    const [x1, y1, x2, y2] = [x(edge.parent), y(edge.parent), x(edge.child), y(edge.child)];
    const types = [...new Set(edge.joints.map((joint) => joint.type))].join(", ");
    const names = edge.joints.map((joint) => joint.name).join(", ");
    const label = `${types} joint ${names} between ${edge.parent} and ${edge.child}: show its messages`;
    const at = deep ? wordPlace(x1, x2, types.length) : { x: x1 + (x2 - x1) * 0.56 };
    at.y = y1 + (y2 - y1) * (deep ? 0.5 : 0.56) + 3.5;
    const place = pressed({ class: "edge", "aria-label": label }, () => chooseEdge(edge.parent, edge.child), [
      s("line", { class: "reach", x1, y1, x2, y2 }),
      s("line", { class: "wire", x1, y1, x2, y2 }),
      s("text", { class: "edge-label", ...at }, types),
    ]);
    edges.push({ place, edge });
    drawing.append(place);
  }
  const room = (column - (deep ? 2 * RING + 10 : 0)) / 6.2; // letters that fit side by side
  state.graph.parts.forEach((part, at) => {
    const [cx, cy] = [x(part.name), y(part.name)];
    const beside = [...placed.values()].filter((place) => place.depth === placed.get(part.name).depth).length === 1;
    const ring = s("circle", { class: "ring", cx, cy, r: RING, transform: `rotate(-90 ${cx} ${cy})` });
    const disc = s("circle", { class: "disc", cx, cy, r: RADIUS });
    const tick = s("path", { class: "tick", d: `M${cx - 4.5} ${cy + 0.5}l3 3.2 6-6.4` });
    const text =
      deep || (beside && depth > 0)
        ? s("text", { class: "node-label", x: cx + RING + 7, y: cy + 4 }, beside ? part.name : shorter(part.name, room))
        : s("text", { class: "node-label middle", x: cx, y: cy + RING + 14 }, shorter(part.name, room));
    const title = s("title");
    const ground = s("circle", { class: "ground", cx, cy, r: RING + 2.5 });
    const rail = s("circle", { class: "rail", cx, cy, r: RING });
    const drawn = [title, ground, rail, ring, disc, tick, text];
    const place = pressed({ class: "node", "data-part": part.name }, () => choosePart(part.name), drawn);
    nodes.set(part.name, { place, ring, disc, title, at, part });
    drawing.append(place);
  });
}

// Where an edge's word stands in a deep tree: right of the child, each in its own column, or left of one whose parent
// would lie over it.
function wordPlace(parent, child, letters) {
  const room = parent - child - 2 * CLEAR;
  if (parent <= child || room > letters * LETTER) return { x: child + CLEAR };
  return { x: child - CLEAR, css: { "text-anchor": "end" } };
}

const shorter = (name, room) => (name.length <= room ? name : `${name.slice(0, Math.max(3, Math.floor(room) - 1))}…`);

// A group that can be pressed, by mouse and keyboard.
function pressed(attributes, act, children) {
  const keydown = (event) => {
    if (event.key !== "Enter" && event.key !== " ") return;
    event.preventDefault();
    event.stopPropagation();
    act();
  };
  const button = { role: "button", tabindex: "0", "aria-pressed": "false", on: { click: act, keydown } };
  return s("g", { ...button, ...attributes }, children);
}

// The posterior's largest standard deviation of a part, and whether it is certain. The estimate knows of what was asked
// for, too; the trace's row is there sooner.
function belief(row, part, at) {
  const estimate = state.estimate?.iteration === shownIteration() ? state.estimate : null;
  const links = part.links.map((link) => estimate?.links[link]).filter(Boolean);
  if (links.length) return [largest(links.flatMap((link) => link.std_xyz ?? [])), links.every((link) => link.certain)];
  return [row?.std[at] ?? null, Boolean(row?.certain?.[at])];
}

function show() {
  const row = rowAt(shownIteration());
  for (const [name, { place, ring, disc, title, at, part }] of nodes) {
    const [std, certain] = belief(row, part, at);
    // full where certain; on the way there by the logarithm, from a tenth at 100 times the limit
    const most = certain ? 1 : OPEN;
    const share = std === null ? 0 : Math.min(most, Math.max(0.06, 1 - Math.log10(std / maxStd()) / 2));
    const label = `${name}, ${certain ? "certain" : "not certain"}, standard deviation ${std === null ? "unknown" : fineCentimetres(std)}`;
    setAttributes(place, {
      "aria-pressed": String(state.view.part === name),
      "aria-label": label,
      "data-certain": String(certain),
    });
    disc.style.fill = colour(part);
    ring.style.stroke = certain ? "" : colour(part);
    ring.style.visibility = std === null ? "hidden" : ""; // its round ends would be a dot
    setAttributes(ring, { "stroke-dasharray": `${(share * AROUND).toFixed(1)} ${AROUND.toFixed(1)}` });
    setText(title, label);
  }
  for (const { place, edge } of edges) {
    const chosen = state.view.edge?.includes(edge.parent) && state.view.edge?.includes(edge.child);
    setAttributes(place, { "aria-pressed": String(Boolean(chosen)) });
  }
}
