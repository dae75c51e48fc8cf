// How has it gone so far? Small plots against the iteration, six where the truth is known, else five, with a cursor at
// the one that is looked at: a canvas each, drawn anew at most ten times a second.

import { byId, h, setText } from "./dom.js";
import { fineCentimetres, number, plain, plural } from "./format.js";
import { MARGIN, paint } from "./plot_canvas.js";
import { maxStd, newestIteration, oldestIteration, onTheme, rowAt, shownIteration, state, subscribe } from "./state.js";
import { goToIteration } from "./view.js";
import { meaning } from "./words.js";

const PACE = 100; // milliseconds between two drawings
const TRUE = "add"; // the plot of what only a known truth tells
const NONE = "–"; // for a number; from the beginning, or a narrow plot would lose a line's height once there is one

// First what is found, then how the algorithm goes about it. Each: the word that explains it, title, whether the scale is
// logarithmic, values of a row (one per part, or one for all), how a value is read, a dashed line, and what the title's
// number says of the row at the cursor.
const PLOTS = [
  {
    id: "std",
    word: "std",
    title: "std per part, cm",
    log: true,
    values: (row) => row.std,
    tick: (v) => plain(v * 100),
    line: maxStd,
    now: (values) => `largest ${fineCentimetres(Math.max(...values))}`,
  },
  {
    id: TRUE,
    word: "add",
    title: "ADD to the truth, cm",
    log: true,
    values: (row) => row.add ?? [],
    tick: (v) => plain(v * 100),
    now: (values) => `largest ${fineCentimetres(Math.max(...values))}`,
  },
  {
    id: "likelihood",
    word: "likelihood",
    title: "log likelihood",
    values: (row) => [row.finalLikelihood],
    tick: (v) => plain(v),
    now: (values) => number(values[0], 1),
  },
  {
    id: "particle-std",
    word: "spread",
    title: "particles' spread, cm",
    log: true,
    values: (row) => row.particleStd,
    tick: (v) => plain(v * 100),
    now: (values) => `largest ${fineCentimetres(Math.max(...values))}`,
  },
  {
    id: "effective",
    word: "effective",
    title: "effective sample size",
    zero: true,
    values: (row) => row.effective,
    tick: (v) => plain(v),
    now: (values) => `smallest ${number(Math.min(...values), 0)}`,
  },
  {
    id: "seconds",
    word: "seconds",
    title: "time per iteration, ms",
    zero: true,
    values: (row) => [row.seconds],
    tick: (v) => plain(v * 1000),
    now: (values) => `${number(values[0] * 1000, 0)}\u202fms`,
  },
];

const places = new Map();
let due = null;

export function install() {
  const place = byId("plots");
  for (const plot of PLOTS) {
    const now = h("span", { class: "now" }, NONE);
    const canvas = h("canvas", { role: "img", "aria-label": plot.title, on: { pointerdown: drag } });
    const figure = h("figure", { class: "plot", "data-plot": plot.id, hidden: plot.id === TRUE }, [
      h(
        "figcaption",
        {},
        h(
          "span",
          { class: "plot-title", "data-word": plot.word, title: `${plot.title}. ${meaning(plot.word)}` },
          plot.title,
        ),
        now,
      ),
      canvas,
    ]);
    place.append(figure);
    places.set(plot.id, { figure, canvas, now });
    new ResizeObserver(soon).observe(canvas);
  }
  onTheme(soon);
  subscribe(["rows", "recalled", "view", "graph", "session"], soon);
}

function soon() {
  if (due) return;
  due = setTimeout(() => {
    due = null;
    requestAnimationFrame(draw);
  }, PACE);
}

function draw() {
  const known = state.graph.truth || Boolean(state.rows.at(-1)?.add);
  for (const plot of PLOTS) {
    const { figure, canvas, now } = places.get(plot.id);
    figure.hidden = plot.id === TRUE && !known;
    if (figure.hidden) continue;
    const row = rowAt(shownIteration());
    const values = (row ? plot.values(row) : []).filter(Number.isFinite);
    setText(now, values.length ? plot.now(values) : NONE);
    canvas.setAttribute(
      "aria-label",
      `${plot.title} over ${plural(state.rows.length, "iteration")}; at iteration ${shownIteration()}: ${now.textContent}`,
    );
    paint(plot, canvas, range());
  }
}

export const range = () => [oldestIteration(), Math.max(newestIteration(), oldestIteration() + 1)];

// Dragging over a plot scrubs.
function drag(event) {
  const canvas = event.currentTarget;
  const go = (moved) => {
    const box = canvas.getBoundingClientRect();
    const [first, last] = range();
    const share = (moved.clientX - box.left - MARGIN.left) / (box.width - MARGIN.left - MARGIN.right);
    goToIteration(Math.round(first + Math.min(1, Math.max(0, share)) * (newestIteration() > first ? last - first : 0)));
  };
  canvas.setPointerCapture(event.pointerId);
  canvas.addEventListener("pointermove", go);
  const stop = () => canvas.removeEventListener("pointermove", go);
  canvas.addEventListener("pointerup", stop, { once: true });
  canvas.addEventListener("pointercancel", stop, { once: true });
  go(event);
}
