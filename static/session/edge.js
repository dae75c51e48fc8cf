// What do two parts say about each other? Both messages of the edge that was chosen: every particle's weight, split into
// what the scan says (unary) and what the other neighbours say.

import { call, root } from "./api.js";
import { binned, histogram, scatter } from "./charts.js";
import { find, h, say } from "./dom.js";
import { nats, number } from "./format.js";
import { colourOf, on, onTheme, shown, state } from "./state.js";
import { change } from "./view.js";
import { paced } from "./pace.js";

export function install() {
  find("edge-close").addEventListener("click", () => change({ edge: null, show: { messages: false } }));
  const draw = paced(drawn, () => `${state.view.edge}@${shown()}`, (text) => {
    if (text) find("messages").replaceChildren(h("p", { class: "calm" }, text));
  });
  on(["view", "rows", "tab"], () => {
    if (!state.view.edge || state.tab !== "estimate") return;
    const [parent, child] = state.view.edge;
    const joints = state.graph.edges.find((edge) => edge.parent === parent && edge.child === child)?.joints ?? [];
    say(find("edge-name"), `${parent} – ${child}`);
    say(find("edge-joints"), joints.map((one) => `${one.name}, ${one.type}`).join("; "));
    draw();
  });
  onTheme(() => draw(true));
}

async function drawn() {
  if (!state.view.edge) return;
  const [parent, child] = state.view.edge;
  const iteration = shown();
  const pairs = [[parent, child], [child, parent]];
  const answers = await Promise.all(pairs.map(([from, to]) =>
    call(`${root(state.id)}/messages/${encodeURIComponent(from)}/${encodeURIComponent(to)}?iteration=${iteration}`)));
  find("messages").replaceChildren(...answers.map((answer, at) => message(answer, ...pairs[at])));
}

function message(answer, from, to) {
  const weights = answer.log_weights.map((value) => (value === null ? 0 : Math.exp(value)));
  const keep = weights.map((_, at) => at).filter((at) => answer.log_unary[at] !== null && answer.log_neighbour[at] !== null);
  const pick = (values) => keep.map((at) => values[at]);
  const [unary, neighbour, heavy] = [pick(answer.log_unary), pick(answer.log_neighbour), pick(weights)];
  const effective = 1 / weights.reduce((sum, weight) => sum + weight * weight, 0);
  const tint = colourOf(to);
  const parts = [
    h("h3", {}, h("span", { class: "swatch", css: { "background-color": colourOf(from) }, "aria-hidden": "true" }), `${from} says where ${to} is`),
    h("p", { class: "facts" }, `${weights.length} particles, ${number(effective, 0)} of them effective`),
  ];
  const alone = new Set(neighbour).size <= 1;
  if (!alone) {
    parts.push(scatter({
      xs: unary, ys: neighbour, weights: heavy, tint, xTitle: "unary factor", yTitle: "neighbours",
      label: `every particle's unary factor against its neighbours' factor, of the message from ${from} to ${to}`,
    }));
  }
  const of = (title, values, weighed) => histogram({
    title, ...binned(values, weighed), estimate: null, read: (value) => nats(value), tint,
  });
  parts.push(h("div", { class: "grid" },
    of("log unary, all particles", unary, null), of("the same, by weight", unary, heavy),
    ...(alone ? [] : [of("log neighbours, all", neighbour, null), of("the same, by weight", neighbour, heavy)])));
  if (alone) parts.push(h("p", { class: "calm" }, `${from} has no other neighbour, so the scan alone weighs these.`));
  return h("section", { class: "message" }, parts);
}
