// How does somebody else get to see this? Links, files, and the calls that gave what is looked at now.

import { sessionPath } from "./api.js";
import { byId, h, setText } from "./dom.js";
import { askedFor, isLive, shownIteration, state, subscribe } from "./state.js";

export function install() {
  for (const copy of document.querySelectorAll("[data-copy]")) {
    copy.addEventListener("click", () => copied(copy, byId(copy.dataset.copy)));
  }
  subscribe(["view", "rows", "tab", "session", "estimate"], show);
}

// What of the view a link carries; `viewOfLink` reads it back.
export function linkParameters() {
  const view = state.view;
  const parameters = new URLSearchParams();
  if (!isLive() && !state.playback) parameters.set("iteration", view.iteration);
  if (view.part) parameters.set("part", view.part);
  if (view.particle !== null) parameters.set("particle", view.particle);
  if (view.edge) parameters.set("edge", view.edge.join(","));
  if (view.compare) parameters.set("compare", [view.compare.session_id, view.compare.iteration ?? ""].join(","));
  if (state.tab !== "belief") parameters.set("tab", state.tab);
  if (view.camera) {
    const { position, look_at: lookAt, up, field_of_view: field } = view.camera;
    const numbers = [...position, ...lookAt, ...up, ...(field ? [field] : [])];
    parameters.set("camera", numbers.map((value) => Number(value.toFixed(4))).join(","));
  }
  return parameters;
}

export function viewOfLink(text) {
  const parameters = new URLSearchParams(text);
  const members = {};
  const whole = (name) => (/^\d{1,9}$/.test(parameters.get(name) ?? "") ? Number(parameters.get(name)) : null);
  if (whole("iteration") !== null) members.iteration = whole("iteration");
  if (parameters.get("part")) members.part = parameters.get("part");
  if (members.part && whole("particle") !== null) members.particle = whole("particle");
  const edge = parameters.get("edge")?.split(",");
  if (edge?.length === 2) Object.assign(members, { edge, show: { messages: true } });
  const [other, iteration] = parameters.get("compare")?.split(",") ?? [];
  if (other) members.compare = { session_id: other, iteration: iteration ? Number(iteration) : null };
  const camera = parameters.get("camera")?.split(",").map(Number);
  if ([9, 10].includes(camera?.length) && camera.every(Number.isFinite)) {
    const [position, lookAt, up] = [camera.slice(0, 3), camera.slice(3, 6), camera.slice(6, 9)];
    members.camera = { position, look_at: lookAt, up, field_of_view: camera[9] ?? null };
  }
  return members;
}

// The commands that answer what is looked at now.
function commands() {
  const api = location.origin + sessionPath(state.id);
  const at = `?iteration=${shownIteration()}`;
  const view = state.view;
  const part = state.graph.parts.find((one) => one.name === view.part);
  const link = part && encodeURIComponent(part.links[0]);
  const asked = askedFor(state.estimate) && state.estimate.iteration === shownIteration() ? "&posterior=true" : "";
  const lines = ["# the estimate", `curl "${api}/estimate${at}${asked}"`];
  if (part && view.particle !== null) {
    lines.push(
      "# why this particle weighs what it does",
      `curl "${api}/beliefs/${link}/particles/${view.particle}${at}"`,
    );
  } else if (part) lines.push(`# the belief about ${part.name}`, `curl "${api}/beliefs/${link}${at}"`);
  if (view.edge)
    lines.push("# a message", `curl "${api}/messages/${view.edge.map(encodeURIComponent).join("/")}${at}"`);
  const now = { iteration: view.iteration, part: view.part, particle: view.particle, show: view.show };
  const body = JSON.stringify(now);
  lines.push("# this 3D view shows it", `curl -X PATCH "${api}/views/${state.viewId}" --json '${body}'`);
  return lines.join("\n");
}

function show() {
  if (state.tab !== "share" || !state.session) return;
  const api = sessionPath(state.id);
  const parameters = linkParameters();
  parameters.delete("tab");
  byId("share-link").value = `${location.origin}/sessions/${state.id}/${parameters.size ? `?${parameters}` : ""}`;
  const [at, stem] = [`?iteration=${shownIteration()}`, `${state.id}-${shownIteration()}`];
  const offer = (id, href, download) => Object.assign(byId(id), { href, download });
  offer("share-recording", `${api}/recording`, "");
  offer("share-scene", `${api}/views/${state.viewId}/scene.html`, `${stem}.html`);
  offer("share-picture", `${api}/estimate.png${at}&width=1280`, `${stem}.png`);
  offer("share-estimate", `${api}/estimate${at}`, `${stem}.json`);
  setText(byId("share-curl"), commands());
}

async function copied(button, source) {
  const text = source.value ?? source.textContent;
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    // without https there is no clipboard but this one
    const field = h("textarea", { class: "unseen" });
    field.value = text;
    document.body.append(field);
    field.select();
    document.execCommand("copy");
    field.remove();
  }
  const word = button.textContent;
  setText(button, "Copied");
  setTimeout(() => setText(button, word === "Copied" ? "Copy" : word), 1500);
}
