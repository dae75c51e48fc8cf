// How do numbers look as small pictures? Histograms, bars and a scatter, in SVG, without anything to press.

import { h, s } from "./dom.js";
import { nats } from "./format.js";

// Densities over edges (one more than densities) with a line at the estimate. `read` writes a value with its unit.
export function histogram({ title, edges, density, estimate, read, tint }) {
  const [width, height] = [156, 44];
  const [low, high] = [edges[0], edges.at(-1)];
  const most = Math.max(...density) || 1;
  const x = (value) => ((value - low) / (high - low || 1)) * width;
  const bars = density.map((value, at) => {
    const tall = (value / most) * (height - 2);
    return s("rect", {
      x: x(edges[at]) + 0.4,
      y: height - tall,
      width: Math.max(0.6, x(edges[at + 1]) - x(edges[at]) - 0.8),
      height: tall,
    });
  });
  const inside = estimate !== null && estimate !== undefined && estimate >= low && estimate <= high;
  const picture = s("svg", { viewBox: `0 0 ${width} ${height}`, "aria-hidden": "true", preserveAspectRatio: "none" }, [
    s("g", { fill: tint }, bars),
    s("line", { class: "base", x1: 0, y1: height - 0.5, x2: width, y2: height - 0.5 }),
    inside ? s("line", { class: "at", x1: x(estimate), y1: 0, x2: x(estimate), y2: height }) : null,
  ]);
  return h("figure", { class: "histogram" }, [
    h("figcaption", {}, [
      h("span", {}, title),
      h("span", { class: "figure" }, estimate === null || estimate === undefined ? "" : read(estimate)),
    ]),
    picture,
    h("div", { class: "ends" }, h("span", {}, read(low)), h("span", {}, read(high))),
  ]);
}

// Counts of values, for a histogram of our own.
export function binned(values, weights, bins = 24) {
  let [low, high] = [Infinity, -Infinity];
  for (const value of values) {
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  if (!Number.isFinite(low)) [low, high] = [0, 1];
  if (high - low < 1e-9) [low, high] = [low - 0.5, high + 0.5];
  const density = new Array(bins).fill(0);
  for (const [at, value] of values.entries()) {
    density[Math.min(bins - 1, Math.floor(((value - low) / (high - low)) * bins))] += weights?.[at] ?? 1;
  }
  return { edges: Array.from({ length: bins + 1 }, (_, at) => low + ((high - low) * at) / bins), density };
}

// Two factors of every particle against each other; heavier particles are larger and stand out.
export function scatter({ xs, ys, weights, tint, label, xTitle, yTitle }) {
  const [width, height, edge] = [340, 150, 14];
  const span = (values) => {
    const finite = values.filter(Number.isFinite).sort((a, b) => a - b);
    const low = finite[Math.floor(finite.length * 0.02)] ?? 0;
    const high = finite.at(-1) ?? 1;
    return [low, high - low < 1e-9 ? low + 1 : high];
  };
  const [x0, x1] = span(xs);
  const [y0, y1] = span(ys);
  const most = Math.max(...weights) || 1;
  const dots = xs
    .map((x, at) => [x, ys[at], weights[at] / most])
    .filter(([x, y]) => x >= x0 && y >= y0)
    .sort((a, b) => a[2] - b[2])
    .map(([x, y, weight]) =>
      s("circle", {
        cx: edge + 8 + ((x - x0) / (x1 - x0)) * (width - 2 * edge - 12),
        cy: 6 + (1 - (y - y0) / (y1 - y0)) * (height - edge - 16),
        r: 1.3 + 3 * Math.sqrt(weight),
        "fill-opacity": (0.18 + 0.7 * weight).toFixed(2),
      }),
    );
  return s("svg", { class: "scatter", viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": label }, [
    s("path", { class: "base", d: `M${edge + 2} 2V${height - edge}H${width - 4}` }),
    s("g", { fill: tint }, dots),
    s("text", { x: width - 4, y: height - 2, "text-anchor": "end" }, `${xTitle} →`),
    s("text", { x: 10, y: 4, transform: "rotate(-90 10 4)", "text-anchor": "end" }, `${yTitle} →`),
  ]);
}

// Signed shares, in nats, as bars from a common zero.
export function bars(entries) {
  const most = Math.max(1e-9, ...entries.map(({ value }) => Math.abs(value ?? 0)));
  return h(
    "dl",
    { class: "bars" },
    entries.map(({ name, value, tint, total }) =>
      h("div", { class: total ? "bar total" : "bar" }, [
        h("dt", { title: name }, name),
        h("dd", {}, [
          h("span", {
            class: "rod",
            "data-sign": value < 0 ? "minus" : "plus",
            "aria-hidden": "true",
            css: { "--long": Math.abs(value ?? 0) / most, ...(tint ? { "--tint": tint } : {}) },
          }),
          h("span", { class: "figure" }, nats(value, 2)),
        ]),
      ]),
    ),
  );
}
