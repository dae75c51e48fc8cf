// How is one plot drawn on its canvas? The frame says where iterations and values are; each function below draws one
// kind of thing into it. Pen, ticks, lines and dots are those of pair_canvas.js, too.

import { colour, rowAt, shownIteration, state } from "./state.js";

export const MARGIN = { top: 6, bottom: 15, left: 34, right: 8 };

// How strong a phase's shade is.
const SHADE = 0.1;
// Radius of a value between two gaps, pixels.
const LONE = 1.8;

const finite = (plot) => (value) => Number.isFinite(value) && (!plot.log || value > 0);

// Draws `plot` over the iterations `first` to `last`.
export function paint(plot, canvas, [first, last]) {
  const { clientWidth: width, clientHeight: height } = canvas;
  if (!width || !height) return;
  const pen = cleared(canvas, width, height);
  const rows = thinned(state.rows, Math.max(50, 2 * width));
  const frame = frameOf(plot, rows, [first, last], width, height);
  const colours = coloursOf(canvas);
  pen.font = `10px ${getComputedStyle(canvas).fontFamily}`;
  drawPhases(pen, rows, frame, colours);
  drawValueAxis(pen, plot, frame, colours);
  drawIterationAxis(pen, [first, last], frame, colours);
  drawLimit(pen, plot, frame, colours);
  drawCursor(pen, frame, colours);
  drawCurves(pen, plot, rows, frame, colours);
}

// A pen whose unit is a pixel of the page, however fine the screen is.
export function cleared(canvas, width, height) {
  const scale = devicePixelRatio || 1;
  const [columns, rows] = [Math.round(width * scale), Math.round(height * scale)];
  if (canvas.width !== columns) canvas.width = columns;
  if (canvas.height !== rows) canvas.height = rows;
  const pen = canvas.getContext("2d", { willReadFrequently: true });
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, width, height);
  return pen;
}

// `x` of an iteration and `y` of a value, in pixels; `low` and `high` are the ends of the axis of values.
function frameOf(plot, rows, [first, last], width, height) {
  const [low, high] = limits(plot, rows);
  const scaled = plot.log ? Math.log10 : (value) => value;
  const [across, down] = [width - MARGIN.left - MARGIN.right, height - MARGIN.top - MARGIN.bottom];
  const x = (iteration) => MARGIN.left + ((iteration - first) / (last - first)) * across;
  const share = (value) => (scaled(value) - scaled(low)) / (scaled(high) - scaled(low) || 1);
  return { width, height, low, high, x, y: (value) => MARGIN.top + (1 - share(value)) * down };
}

export function coloursOf(canvas) {
  const style = getComputedStyle(canvas);
  const names = ["--quiet", "--line", "--ink", "--accent", "--going"];
  const [quiet, faint, ink, searching, rest] = names.map((name) => style.getPropertyValue(name));
  return { quiet, faint, ink, searching, "at rest": rest };
}

// Behind the curves: where it searches, and where it is at rest; between them it settles.
function drawPhases(pen, rows, { width, height, x }, tints) {
  const bottom = height - MARGIN.bottom;
  for (const [phase, first, last] of spans(rows.map((row) => [row.iteration, row.phase]))) {
    if (phase === "settling") continue;
    const from = Math.max(MARGIN.left, x(first - 0.5));
    const to = Math.min(width - MARGIN.right, x(last + 0.5));
    pen.fillStyle = tints[phase];
    pen.globalAlpha = SHADE;
    pen.fillRect(from, MARGIN.top - 4, to - from, bottom - MARGIN.top + 4);
  }
  pen.globalAlpha = 1;
}

// [what, first, last] of the stretches over which it is the same.
function spans(entries) {
  const found = [];
  for (const [iteration, what] of entries) {
    if (found.at(-1)?.[0] === what) found.at(-1)[2] = iteration;
    else found.push([what, iteration, iteration]);
  }
  return found;
}

function drawValueAxis(pen, plot, { width, low, high, y }, { quiet, faint }) {
  pen.lineWidth = 1;
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  pen.strokeStyle = faint;
  pen.fillStyle = quiet;
  for (const tick of ticks(plot, low, high)) {
    drawAcross(pen, width, y(tick));
    pen.fillText(plot.tick(tick), MARGIN.left - 5, y(tick));
  }
}

function drawIterationAxis(pen, [first, last], { width, height }, { quiet }) {
  pen.textBaseline = "alphabetic";
  pen.fillStyle = quiet;
  pen.textAlign = "left";
  pen.fillText(String(first), MARGIN.left, height - 3);
  pen.textAlign = "right";
  pen.fillText(String(last), width - MARGIN.right, height - 3);
}

// The dashed line at the value that is to be reached.
function drawLimit(pen, plot, { width, low, high, y }, { quiet }) {
  const limit = plot.line?.();
  if (!limit || limit < low || limit > high) return;
  pen.strokeStyle = quiet;
  pen.setLineDash([4, 4]);
  drawAcross(pen, width, y(limit));
  pen.setLineDash([]);
}

function drawCursor(pen, { height, x }, { ink }) {
  const at = Math.round(x(shownIteration())) + 0.5;
  pen.strokeStyle = ink;
  pen.globalAlpha = 0.35;
  drawLine(pen, [at, at], [MARGIN.top - 4, height - MARGIN.bottom + 3]);
  pen.globalAlpha = 1;
}

// A curve per part, or one of the whole, with a dot at the iteration that is looked at.
function drawCurves(pen, plot, rows, frame, colours) {
  const count = rows[0] ? plot.values(rows[0]).length : 0;
  const whole = count === 1 && state.graph.parts.length !== 1;
  for (let index = 0; index < count; index++) {
    const part = whole ? null : state.graph.parts[index];
    const selected = part !== null && part?.name === state.view.part;
    const tint = part && colour(part) !== "currentcolor" ? colour(part) : colours.quiet;
    pen.globalAlpha = part !== null && state.view.part && !selected ? 0.25 : 1;
    pen.strokeStyle = pen.fillStyle = whole ? colours.ink : tint;
    pen.lineWidth = selected ? 2.2 : 1.6;
    const points = rows.map((row) => [row.iteration, plot.values(row)[index]]);
    drawCurve(pen, stretches(points, finite(plot)), frame);
    const row = rowAt(shownIteration());
    const value = row && plot.values(row)[index];
    if (finite(plot)(value)) drawDot(pen, frame.x(row.iteration), frame.y(value));
  }
  pen.globalAlpha = 1;
}

// The points between the gaps: where nothing is known no line is drawn.
function stretches(points, known) {
  const found = [];
  let before = false;
  for (const point of points) {
    const here = known(point[1]);
    if (here && !before) found.push([]);
    if (here) found.at(-1).push(point);
    before = here;
  }
  return found;
}

function drawCurve(pen, all, { width, height, x, y }) {
  pen.save();
  pen.beginPath();
  pen.rect(MARGIN.left - 3, 0, width - MARGIN.left, height - MARGIN.bottom + 1);
  pen.clip();
  pen.lineJoin = "round";
  for (const points of all) {
    const [xs, ys] = [points.map(([iteration]) => x(iteration)), points.map(([, value]) => y(value))];
    if (points.length > 1) drawLine(pen, xs, ys);
    else drawDot(pen, xs[0], ys[0], LONE); // a line of one point is none
  }
  pen.restore();
}

export function drawDot(pen, x, y, radius = 2.6) {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 2 * Math.PI);
  pen.fill();
}

const drawAcross = (pen, width, y) => drawLine(pen, [MARGIN.left, width - MARGIN.right], [y, y]);

export function drawLine(pen, xs, ys) {
  pen.beginPath();
  xs.forEach((x, at) => {
    pen.lineTo(x, ys[at]); // the first one only moves the pen
  });
  pen.stroke();
}

function thinned(rows, most) {
  const stride = Math.ceil(rows.length / most);
  return stride > 1 ? rows.filter((_, at) => at % stride === 0 || at === rows.length - 1) : rows;
}

function limits(plot, rows) {
  const all = rows.flatMap(plot.values).filter(finite(plot));
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
  if (plot.log) return [Math.max(low / 1.3, high / 1e5), high * 1.3];
  if (plot.zero) low = 0;
  const room = (high - low || Math.abs(high) || 1) * 0.06;
  return [plot.zero ? 0 : low - room, high + room];
}

// Round numbers, at a linear scale about `count` of them.
export function ticks(plot, low, high, count = 2.4) {
  if (plot.log) {
    const powers = [];
    for (let power = Math.ceil(Math.log10(low)); 10 ** power <= high; power++) powers.push(10 ** power);
    const every = Math.ceil(powers.length / 4);
    if (powers.length > 1) return powers.filter((_, place) => place % every === 0);
    const mantissas = [1, 2, 5].flatMap((m) => [-5, -4, -3, -2, -1, 0, 1].map((p) => m * 10 ** p));
    return mantissas
      .filter((value) => value >= low && value <= high)
      .sort((a, b) => a - b)
      .slice(-3);
  }
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((m) => m * power).find((value) => value >= rough) ?? rough;
  const rounds = [];
  for (let value = Math.ceil(low / step) * step; value <= high; value += step) rounds.push(value);
  return rounds;
}
