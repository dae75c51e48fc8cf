// How do weighted draws look in two coordinates? A scatter, each mode in a colour of its own and each dot as large as it
// weighs, the estimate as a cross, and along the edges the histograms of either coordinate by weight.

import { number } from "./format.js";
import { cleared, coloursOf, drawDot, drawLine, ticks } from "./plot_canvas.js";

// Of the posterior's modes, heaviest first.
export const MODE_COLOURS = ["--accent", "--waiting", "--going", "--wrong", "--quiet", "--ink"];

const MARGIN = { left: 44, bottom: 32, top: 6, right: 6 };
const EDGE = 38; // pixels of a histogram's height
const GAP = 5;
const BINS = 32;
const TICKS = 4; // of an axis, about
const CROSS = 7; // pixels of half the estimate's cross
const DOT = 4.5; // radius of the heaviest draw; the lightest ones are still to be seen
const LEAST = 0.9;

// `axes` : across and up, each with title, values, estimate, low and high; `weights`, `mode` : of the draws.
export function paintPair(canvas, [across, up], weights, mode) {
  const { clientWidth: width, clientHeight: height } = canvas;
  if (!width || !height) return;
  const pen = cleared(canvas, width, height);
  const style = getComputedStyle(canvas);
  const modes = MODE_COLOURS.map((name) => style.getPropertyValue(name));
  const colours = coloursOf(canvas);
  const box = {
    left: MARGIN.left,
    right: width - MARGIN.right - EDGE - GAP,
    top: MARGIN.top + EDGE + GAP,
    bottom: height - MARGIN.bottom,
  };
  const place =
    ({ low, high }, from, to) =>
    (value) =>
      from + ((value - low) / (high - low)) * (to - from);
  const [x, y] = [place(across, box.left, box.right), place(up, box.bottom, box.top)];
  pen.font = `10px ${style.fontFamily}`;
  drawFrame(pen, box, colours);
  drawAcross(pen, across, x, box, colours);
  drawUp(pen, up, y, box, colours);
  drawDraws(pen, across.values.map(x), up.values.map(y), weights, mode, modes, box);
  for (const { at, from, to, base, share } of bars(across, weights, mode)) {
    pen.fillStyle = modes[at];
    pen.fillRect(x(from) + 0.4, box.top - GAP - (base + share) * EDGE, x(to) - x(from) - 0.8, share * EDGE);
  }
  for (const { at, from, to, base, share } of bars(up, weights, mode)) {
    pen.fillStyle = modes[at];
    pen.fillRect(box.right + GAP + base * EDGE, y(to) + 0.4, share * EDGE, y(from) - y(to) - 0.8);
  }
  drawCross(pen, x(across.estimate), y(up.estimate), colours);
}

function drawFrame(pen, { left, right, top, bottom }, { faint }) {
  pen.strokeStyle = faint;
  pen.lineWidth = 1;
  pen.strokeRect(left + 0.5, top + 0.5, right - left - 1, bottom - top - 1);
}

// As many places as tell two ticks apart.
function written(all) {
  const step = all.length > 1 ? all[1] - all[0] : Math.abs(all[0]) || 1;
  const places = Math.max(0, Math.ceil(-Math.log10(step) - 1e-9));
  return (value) => number(value, Math.min(places, 6));
}

function drawAcross(pen, axis, x, { left, right, top, bottom }, { quiet, faint }) {
  const all = ticks(axis, axis.low, axis.high, TICKS);
  const write = written(all);
  pen.textBaseline = "alphabetic";
  pen.textAlign = "center";
  for (const tick of all) {
    pen.strokeStyle = faint;
    drawLine(pen, [x(tick), x(tick)], [top, bottom]);
    pen.fillStyle = quiet;
    pen.fillText(write(tick), x(tick), bottom + 12);
  }
  pen.fillText(axis.title, (left + right) / 2, bottom + 27, right - left);
}

function drawUp(pen, axis, y, { left, right, top, bottom }, { quiet, faint }) {
  const all = ticks(axis, axis.low, axis.high, TICKS);
  const write = written(all);
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  for (const tick of all) {
    pen.strokeStyle = faint;
    drawLine(pen, [left, right], [y(tick), y(tick)]);
    pen.fillStyle = quiet;
    pen.fillText(write(tick), left - 4, y(tick));
  }
  pen.save();
  pen.translate(8, (top + bottom) / 2);
  pen.rotate(-Math.PI / 2);
  pen.textAlign = "center";
  pen.fillText(axis.title, 0, 0, bottom - top);
  pen.restore();
}

function drawDraws(pen, xs, ys, weights, mode, modes, { left, right, top, bottom }) {
  const most = Math.max(...weights);
  pen.save();
  pen.beginPath();
  pen.rect(left, top, right - left, bottom - top);
  pen.clip();
  pen.globalAlpha = 0.5;
  weights.forEach((weight, at) => {
    if (!(weight > 0)) return;
    pen.fillStyle = modes[mode[at]];
    drawDot(pen, xs[at], ys[at], LEAST + (DOT - LEAST) * Math.sqrt(weight / most));
  });
  pen.restore();
}

// A coordinate's histogram, the modes' bars on top of each other: which mode, between which values, and from which base
// how high, as shares of the highest.
function bars({ values, low, high }, weights, mode) {
  const count = Math.max(...mode) + 1;
  const sums = Array.from({ length: BINS }, () => new Array(count).fill(0));
  values.forEach((value, draw) => {
    const bin = Math.floor(((value - low) / (high - low)) * BINS);
    if (bin >= 0 && bin < BINS) sums[bin][mode[draw]] += weights[draw];
  });
  const total = (bin, modes = count) => bin.slice(0, modes).reduce((sum, one) => sum + one, 0);
  const most = Math.max(...sums.map((bin) => total(bin))) || 1;
  const edge = (place) => low + ((high - low) * place) / BINS;
  return sums.flatMap((bin, place) =>
    bin.map((sum, at) => ({
      at,
      from: edge(place),
      to: edge(place + 1),
      base: total(bin, at) / most,
      share: sum / most,
    })),
  );
}

function drawCross(pen, x, y, { ink }) {
  pen.strokeStyle = ink;
  pen.lineWidth = 2;
  drawLine(pen, [x - CROSS, x + CROSS], [y, y]);
  drawLine(pen, [x, x], [y - CROSS, y + CROSS]);
}
