// From where to look next, where a link is not certain? What hides it from the scans, and the places from which another
// scan is expected to tell most, best first; the 3D view draws them as numbered cameras. They are asked for unasked: at
// rest that takes less time than two iterations.

import { call, iterationQuery, linksQuery, sessionPath } from "./api.js";
import { byId, h, reconcile, sentence, setText } from "./dom.js";
import { fineCentimetres, largest, nats, percent, plural } from "./format.js";
import { colour, hasPosterior, onTheme, partNamed, partOfLink, state, subscribe } from "./state.js";
import { throttled } from "./throttle.js";
import { cross, dot, listed, mean, minus, plus, turned, unit } from "./vectors.js";
import { changeView } from "./view.js";

// Of a part less is not worth a word.
const LITTLE = 0.05;
// Parts whose sight is told.
const LISTED = 4;
// All cameras are seen from so many times as far from the object, and from so much higher, as a share of that.
const FARTHER = 3.4;
const STEEP = 0.9;
// Below this square of the sine between them, two directions are taken for one.
const LEVEL = 1e-3;

let answered = null; // with what was asked

export function install() {
  const ask = throttled(fetchViews, key, sentence("next-calm"));
  const update = () => {
    byId("next-views").hidden = !wanted();
    if (state.tab !== "belief" || !wanted() || !byId("next-views").open) return;
    show();
    ask();
  };
  byId("next-views").addEventListener("toggle", update);
  byId("views-all").addEventListener("click", seeAll);
  subscribe(["estimate", "view", "tab", "graph"], update);
  onTheme(update);
}

const uncertain = () => {
  const links = partNamed(state.view.part)?.links ?? Object.keys(state.estimate?.links ?? {});
  return links.filter((link) => !state.estimate?.links[link]?.certain);
};
const wanted = () => hasPosterior(state.estimate) && state.estimate.fit === "good" && uncertain().length > 0;

// While the inference stays at rest, so do its posterior and what follows from it.
function key() {
  if (!wanted()) return "";
  const { posterior_iteration: iteration, effective_draws: draws, max_std: limit } = state.estimate;
  return [iteration, draws, limit, ...uncertain()].join();
}

async function fetchViews() {
  if (!wanted()) return;
  const asked = key();
  const path = `${sessionPath(state.id)}/decision${iterationQuery(state.estimate.iteration)}`;
  answered = { asked, ...(await call(`${path}${linksQuery(uncertain())}`)) };
  if (state.view.next_view !== null) changeView({ next_view: null }); // it was one of others
  show();
}

function show() {
  const known = wanted() && answered?.asked === key() ? answered : null;
  byId("blocked").replaceChildren(...(known ? hidden(known) : []));
  const views = known?.views.filter((view) => view.worthwhile) ?? []; // those that are drawn
  reconcile(byId("views"), "view-row", views, (_, at) => at, showView);
  byId("views").hidden = byId("views-calm").hidden = !views.length;
  byId("views-none").hidden = !known || views.length > 0;
}

// A line for each part, least known first: links that move together are hidden together.
function hidden({ blocking, sight }) {
  const std = (link) => largest(state.estimate.links[link].std_xyz);
  const parts = new Map(blocking.map((link) => [partOfLink(link) ?? { name: link }, link]));
  const all = [...parts].sort(([, one], [, other]) => std(other) - std(one));
  const lines = all
    .slice(0, LISTED)
    .map(([part, link]) =>
      h("li", {}, [
        h("span", { class: "swatch", css: { "background-color": colour(part) }, "aria-hidden": "true" }),
        h("span", {}, `${part.name} ±${fineCentimetres(std(link))}: ${blocked(sight[link])}`),
      ]),
    );
  if (all.length > LISTED)
    lines.push(
      h(
        "li",
        {},
        h("span", { class: "swatch", css: { visibility: "hidden" } }),
        `and ${plural(all.length - LISTED, "other")}`,
      ),
    );
  return lines;
}

function blocked(sight) {
  if (!sight) return "outside the scans";
  const others = Object.entries(sight.behind).map(([part, share]) => [share, `behind ${part}`]);
  const reasons = [...others, [sight.in_front, "behind something else"]].filter(([share]) => share > LITTLE);
  const words = reasons.map(([share, where]) => `${percent(share)} ${where}`);
  return [`${percent(sight.seen)} in sight`, ...words].join(", ");
}

function showView(row, view, at) {
  const press = row.firstElementChild;
  const [index, bar, gain, after] = press.children;
  const best = answered.views[0].expected_gain_nats || 1;
  setText(index, `${at + 1}`);
  bar.style.setProperty("--share", view.expected_gain_nats / best);
  setText(gain, nats(view.expected_gain_nats));
  const [link, std] = worst(view);
  setText(after, `then ${link} ±${fineCentimetres(std)}`);
  press.setAttribute("aria-label", `look from place ${at + 1}: gain ${gain.textContent} nats, ${after.textContent}`);
  press.setAttribute("aria-pressed", String((state.view.next_view ?? 0) === at));
  const emphasise = () => state.view.next_view !== at && changeView({ next_view: at });
  Object.assign(press, { onmouseenter: emphasise, onfocus: emphasise });
  press.onclick = () => changeView({ next_view: at, camera: eye(view.pose) });
}

// The link that is expected to be known least after a scan from there.
function worst({ expected_std_xyz: stds }) {
  const all = Object.entries(stds).map(([link, std]) => [link, largest(std)]);
  return all.reduce((most, one) => (one[1] > most[1] ? one : most));
}

// A camera's pose as the 3D view looks from there, about the point ahead that is nearest to the object's middle.
function eye({ position, orientation }) {
  const ahead = turned([0, 0, 1], orientation);
  const at = listed(position);
  const far = Math.max(0.1, dot(ahead, minus(middle(), at)));
  return { position: at, look_at: plus(at, ahead, far), up: turned([0, -1, 0], orientation) };
}

// Look at the object with all of the cameras around it, from above the best one's side.
function seeAll() {
  const { views } = answered;
  const centre = middle();
  const eyes = views.map((view) => minus(listed(view.pose.position), centre));
  const up = upwards(views);
  const level = plus(eyes[0], up, -dot(eyes[0], up));
  const aside = plus(unit(level), up, STEEP);
  const { clientWidth: width, clientHeight: height } = byId("scene");
  const reach = Math.max(...eyes.map((one) => Math.hypot(...one)));
  const far = FARTHER * reach * Math.max(1, height / width); // its field of view is from top to bottom
  changeView({ camera: { position: plus(centre, unit(aside), far), look_at: centre, up }, show: { next_views: true } });
}

// Up in world: cameras that look around level have it across all of their right sides.
function upwards(views) {
  const up = turned([0, -1, 0], views[0].pose.orientation);
  const rights = views.map((view) => turned([1, 0, 0], view.pose.orientation));
  const across = rights.map((right) => cross(rights[0], right)).reduce((a, b) => (dot(b, b) > dot(a, a) ? b : a));
  if (dot(across, across) < LEVEL) return up;
  return unit(across.map((one) => one * Math.sign(dot(across, up))));
}

// Of where the links are.
const middle = () => mean(Object.values(state.estimate.links).map(({ pose }) => listed(pose.position)));
