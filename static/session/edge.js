// What do two parts say about each other? Both messages of the edge that was chosen: every particle's weight, split into
// what the scan says (unary) and what the other neighbours say.

import { call, sessionPath } from "./api.js";
import { binned, histogram, scatter } from "./charts.js";
import { byId, h, insteadOf, setText } from "./dom.js";
import { nats, number } from "./format.js";
import { colourOf, onTheme, shownIteration, state, subscribe } from "./state.js";
import { throttled } from "./throttle.js";
import { changeView } from "./view.js";

export function install() {
  byId("edge-close").addEventListener("click", () => changeView({ edge: null, show: { messages: false } }));
  const draw = throttled(drawMessages, () => `${state.view.edge}@${shownIteration()}`, insteadOf("messages"));
  subscribe(["view", "rows", "tab"], () => {
    if (!state.view.edge || state.tab !== "belief") return;
    const [parent, child] = state.view.edge;
    const joints = state.graph.edges.find((edge) => edge.parent === parent && edge.child === child)?.joints ?? [];
    setText(byId("edge-name"), `${parent} – ${child}`);
    setText(byId("edge-joints"), joints.map((one) => `${one.name}, ${one.type}`).join("; "));
    draw();
  });
  onTheme(() => draw(true));
}

async function drawMessages() {
  if (!state.view.edge) return;
  const [parent, child] = state.view.edge;
  const iteration = shownIteration();
  const path = (...ends) => `${sessionPath(state.id)}/messages/${ends.map(encodeURIComponent).join("/")}`;
  const pairs = [
    [parent, child],
    [child, parent],
  ];
  const answers = await Promise.all(pairs.map(([from, to]) => call(`${path(from, to)}?iteration=${iteration}`)));
  byId("messages").replaceChildren(...answers.map((answer, at) => message(answer, ...pairs[at])));
}

function message(answer, from, to) {
  const weights = answer.log_weights.map((value) => (value === null ? 0 : Math.exp(value)));
  const keep = weights
    .map((_, at) => at)
    .filter((at) => answer.log_unary[at] !== null && answer.log_neighbour[at] !== null);
  const pick = (values) => keep.map((at) => values[at]);
  const [unary, neighbour, heavy] = [pick(answer.log_unary), pick(answer.log_neighbour), pick(weights)];
  const effective = 1 / weights.reduce((sum, weight) => sum + weight * weight, 0);
  const tint = colourOf(to);
  const parts = [
    h("h3", {}, [
      h("span", { class: "swatch", css: { "background-color": colourOf(from) }, "aria-hidden": "true" }),
      `${from} says where ${to} is`,
    ]),
    h("p", { class: "facts" }, `${weights.length} particles, ${number(effective, 0)} of them effective`),
  ];
  const alone = new Set(neighbour).size <= 1;
  if (!alone) {
    parts.push(
      scatter({
        xs: unary,
        ys: neighbour,
        weights: heavy,
        tint,
        xTitle: "unary factor",
        yTitle: "neighbours",
        label: `every particle's unary factor against its neighbours' factor, of the message from ${from} to ${to}`,
      }),
    );
  }
  const of = (title, values, weighed) =>
    histogram({ title, ...binned(values, weighed), estimate: null, read: (value) => nats(value), tint });
  parts.push(
    h("div", { class: "grid" }, [
      of("log unary, all particles", unary, null),
      of("the same, by weight", unary, heavy),
      ...(alone ? [] : [of("log neighbours, all", neighbour, null), of("the same, by weight", neighbour, heavy)]),
    ]),
  );
  if (alone) parts.push(h("p", { class: "calm" }, `${from} has no other neighbour, so the scan alone weighs these.`));
  return h("section", { class: "message" }, parts);
}
