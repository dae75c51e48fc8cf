// How has it gone so far? Small plots against the iteration, five where the truth is known, else four, with a cursor at
// the one that is looked at: a canvas each, drawn anew at most ten times a second.

import { find, h, say } from "./dom.js";
import { millimetres, number, plain, plural } from "./format.js";
import { colour, maxStd, newest, oldest, on, onTheme, rowAt, shown, state } from "./state.js";
import { goTo } from "./view.js";

const PACE = 100; // milliseconds between two drawings
const TOP = 6;
const BOTTOM = 15;
const LEFT = 34;
const RIGHT = 8;

// Each: title, whether the scale is logarithmic, values of a row (one per part, or one for all), how a value is read, a
// dashed line, and what the title's number says of the row at the cursor.
const PLOTS = [
  {
    id: "std", title: "std per part, mm", log: true, values: (row) => row.std, tick: (v) => plain(v * 1000),
    line: maxStd, now: (values) => `largest ${millimetres(Math.max(...values))}`,
  },
  {
    id: "effective", title: "effective sample size", log: false, zero: true, values: (row) => row.effective,
    tick: (v) => plain(v), now: (values) => `smallest ${number(Math.min(...values), 0)}`,
  },
  {
    id: "likelihood", title: "log likelihood", log: false, values: (row) => [row.likelihood], tick: (v) => plain(v),
    now: (values) => number(values[0], 1),
  },
  {
    id: "add", title: "ADD to the truth, mm", log: true, values: (row) => row.add ?? [],
    tick: (v) => plain(v * 1000), now: (values) => `largest ${millimetres(Math.max(...values), 2)}`,
  },
  {
    id: "seconds", title: "time per iteration, ms", log: false, zero: true, values: (row) => [row.seconds],
    tick: (v) => plain(v * 1000), now: (values) => `${number(values[0] * 1000, 0)}\u202fms`,
  },
];

const places = new Map();
let due = null;

export function install() {
  const place = find("plots");
  for (const plot of PLOTS) {
    const now = h("span", { class: "now" });
    const canvas = h("canvas", { role: "img", "aria-label": plot.title, on: { pointerdown: drag } });
    const figure = h("figure", { class: "plot", "data-plot": plot.id },
      h("figcaption", {}, h("span", { class: "plot-title" }, plot.title), now), canvas);
    place.append(figure);
    places.set(plot.id, { figure, canvas, now });
    new ResizeObserver(soon).observe(canvas);
  }
  onTheme(soon);
  on(["rows", "recalled", "view", "graph", "session"], soon);
}

function soon() {
  due ??= setTimeout(() => {
    due = null;
    requestAnimationFrame(draw);
  }, PACE);
}

function draw() {
  const known = state.graph.truth || Boolean(state.rows.at(-1)?.add);
  for (const plot of PLOTS) {
    const { figure, canvas, now } = places.get(plot.id);
    figure.hidden = plot.id === "add" && !known;
    if (figure.hidden) continue;
    const row = rowAt(shown());
    const values = (row ? plot.values(row) : []).filter(Number.isFinite);
    say(now, values.length ? plot.now(values) : "–");
    canvas.setAttribute("aria-label", `${plot.title} over ${plural(state.rows.length, "iteration")}; at iteration ${shown()}: ${now.textContent}`);
    paint(plot, canvas);
  }
}

export const range = () => [oldest(), Math.max(newest(), oldest() + 1)];

function paint(plot, canvas) {
  const scale = devicePixelRatio || 1;
  const width = canvas.clientWidth;
  const height = canvas.clientHeight;
  if (!width || !height) return;
  if (canvas.width !== Math.round(width * scale)) canvas.width = Math.round(width * scale);
  if (canvas.height !== Math.round(height * scale)) canvas.height = Math.round(height * scale);
  const pen = canvas.getContext("2d", { willReadFrequently: true });
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, width, height);

  const style = getComputedStyle(canvas);
  const quiet = style.getPropertyValue("--quiet");
  const faint = style.getPropertyValue("--line");
  const ink = style.getPropertyValue("--ink");
  const [first, last] = range();
  const rows = thinned(state.rows, Math.max(50, 2 * width));
  const [low, high] = limits(plot, rows);
  const f = plot.log ? Math.log10 : (v) => v;
  const x = (iteration) => LEFT + ((iteration - first) / (last - first)) * (width - LEFT - RIGHT);
  const y = (value) => TOP + (1 - (f(value) - f(low)) / (f(high) - f(low) || 1)) * (height - TOP - BOTTOM);

  pen.font = `10px ${style.fontFamily}`;
  pen.lineWidth = 1;
  pen.textBaseline = "middle";
  for (const tick of ticks(plot, low, high)) {
    pen.strokeStyle = faint;
    line(pen, [[LEFT, y(tick)], [width - RIGHT, y(tick)]]);
    pen.fillStyle = quiet;
    pen.textAlign = "right";
    pen.fillText(plot.tick(tick), LEFT - 5, y(tick));
  }
  pen.textBaseline = "alphabetic";
  pen.fillStyle = quiet;
  pen.textAlign = "left";
  pen.fillText(String(first), LEFT, height - 3);
  pen.textAlign = "right";
  pen.fillText(String(last), width - RIGHT, height - 3);
  const limit = plot.line?.();
  if (limit && limit >= low && limit <= high) {
    pen.strokeStyle = quiet;
    pen.setLineDash([4, 4]);
    line(pen, [[LEFT, y(limit)], [width - RIGHT, y(limit)]]);
    pen.setLineDash([]);
  }

  const cursor = Math.round(x(shown())) + 0.5;
  pen.strokeStyle = ink;
  pen.globalAlpha = 0.35;
  line(pen, [[cursor, TOP - 4], [cursor, height - BOTTOM + 3]]);
  pen.globalAlpha = 1;

  const count = rows[0] ? plot.values(rows[0]).length : 0;
  const single = count === 1 && state.graph.parts.length !== 1;
  pen.lineJoin = "round";
  for (let part = 0; part < count; part++) {
    const one = state.graph.parts[part];
    const faded = !single && state.view.part && one?.name !== state.view.part;
    pen.globalAlpha = faded ? 0.25 : 1;
    pen.strokeStyle = pen.fillStyle = single ? ink : colour(one) === "currentcolor" ? quiet : colour(one);
    pen.lineWidth = !single && one?.name === state.view.part ? 2.2 : 1.6;
    const points = rows
      .map((row) => [row.iteration, plot.values(row)[part]])
      .filter(([, value]) => Number.isFinite(value) && (!plot.log || value > 0));
    pen.save();
    pen.beginPath();
    pen.rect(LEFT - 3, 0, width - LEFT, height - BOTTOM + 1);
    pen.clip();
    line(pen, points.map(([iteration, value]) => [x(iteration), y(value)]));
    pen.restore();
    const row = rowAt(shown());
    const value = row && plot.values(row)[part];
    if (Number.isFinite(value) && (!plot.log || value > 0)) {
      pen.beginPath();
      pen.arc(x(row.iteration), y(value), 2.6, 0, 7);
      pen.fill();
    }
  }
  pen.globalAlpha = 1;
}

function line(pen, points) {
  pen.beginPath();
  points.forEach(([px, py], at) => (at ? pen.lineTo(px, py) : pen.moveTo(px, py)));
  pen.stroke();
}

function thinned(rows, most) {
  const stride = Math.ceil(rows.length / most);
  return stride > 1 ? rows.filter((_, at) => at % stride === 0 || at === rows.length - 1) : rows;
}

function limits(plot, rows) {
  const all = rows.flatMap(plot.values).filter((value) => Number.isFinite(value) && (!plot.log || value > 0));
  const limit = plot.line?.();
  if (limit) all.push(limit);
  if (!all.length) return plot.log ? [0.001, 1] : [0, 1];
  let low = Infinity;
  let high = -Infinity;
  for (const value of all) {
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  // a belief that has collapsed for an iteration is no reason to squeeze all others into a line
  if (plot.log) return [Math.max(low / 1.3, high / 1e5, (limit ?? 0) / 10), high * 1.3];
  if (plot.zero) low = 0;
  const room = (high - low || Math.abs(high) || 1) * 0.06;
  return [plot.zero ? 0 : low - room, high + room];
}

// Two to four round numbers.
function ticks(plot, low, high) {
  if (plot.log) {
    const found = [];
    for (let power = Math.ceil(Math.log10(low)); 10 ** power <= high; power++) found.push(10 ** power);
    const every = Math.ceil(found.length / 4);
    if (found.length > 1) return found.filter((_, place) => place % every === 0);
    const mantissas = [1, 2, 5].flatMap((m) => [-5, -4, -3, -2, -1, 0, 1].map((p) => m * 10 ** p));
    return mantissas.filter((value) => value >= low && value <= high).sort((a, b) => a - b).slice(-3);
  }
  const rough = (high - low) / 2.4;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((m) => m * power).find((value) => value >= rough) ?? rough;
  const found = [];
  for (let value = Math.ceil(low / step) * step; value <= high; value += step) found.push(value);
  return found;
}

// Dragging over a plot scrubs.
function drag(event) {
  const canvas = event.currentTarget;
  const go = (moved) => {
    const box = canvas.getBoundingClientRect();
    const [first, last] = range();
    const share = (moved.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
    goTo(Math.round(first + Math.min(1, Math.max(0, share)) * (newest() > first ? last - first : 0)));
  };
  canvas.setPointerCapture(event.pointerId);
  canvas.addEventListener("pointermove", go);
  const stop = () => canvas.removeEventListener("pointermove", go);
  canvas.addEventListener("pointerup", stop, { once: true });
  canvas.addEventListener("pointercancel", stop, { once: true });
  go(event);
}
