// How does somebody else get to see this? Links, files, and the calls that gave what is looked at now.

import { root } from "./api.js";
import { find, h, say } from "./dom.js";
import { isLive, on, shown, state } from "./state.js";

export function install() {
  for (const copy of document.querySelectorAll("[data-copy]")) {
    copy.addEventListener("click", () => copied(copy, find(copy.dataset.copy)));
  }
  on(["view", "rows", "tab", "session"], show);
}

// What of the view a link carries; `restored` reads it back.
export function query() {
  const view = state.view;
  const found = new URLSearchParams();
  if (!isLive()) found.set("iteration", view.iteration);
  if (view.part) found.set("part", view.part);
  if (view.particle !== null) found.set("particle", view.particle);
  if (view.edge) found.set("edge", view.edge.join(","));
  if (view.compare) found.set("compare", [view.compare.session_id, view.compare.iteration ?? ""].join(","));
  if (state.tab !== "estimate") found.set("tab", state.tab);
  if (view.camera) {
    const { position, look_at: lookAt, up } = view.camera;
    found.set("camera", [...position, ...lookAt, ...up].map((value) => Number(value.toFixed(4))).join(","));
  }
  return found;
}

export function restored(text) {
  const given = new URLSearchParams(text);
  const members = {};
  const whole = (name) => (/^\d{1,9}$/.test(given.get(name) ?? "") ? Number(given.get(name)) : null);
  if (whole("iteration") !== null) members.iteration = whole("iteration");
  if (given.get("part")) members.part = given.get("part");
  if (members.part && whole("particle") !== null) members.particle = whole("particle");
  const edge = given.get("edge")?.split(",");
  if (edge?.length === 2) Object.assign(members, { edge, show: { messages: true } });
  const [other, iteration] = given.get("compare")?.split(",") ?? [];
  if (other) members.compare = { session_id: other, iteration: iteration ? Number(iteration) : null };
  const camera = given.get("camera")?.split(",").map(Number);
  if (camera?.length === 9 && camera.every(Number.isFinite)) {
    members.camera = { position: camera.slice(0, 3), look_at: camera.slice(3, 6), up: camera.slice(6) };
  }
  return members;
}

// The commands that answer what is looked at now.
export function commands() {
  const api = location.origin + root(state.id);
  const view = state.view;
  const part = state.graph.parts.find((one) => one.name === view.part);
  const link = part && encodeURIComponent(part.links[0]);
  const lines = [["the estimate", `curl "${api}/estimate?iteration=${shown()}"`]];
  if (part && view.particle !== null) lines.push(["why this particle weighs what it does", `curl "${api}/beliefs/${link}/particles/${view.particle}?iteration=${shown()}"`]);
  else if (part) lines.push([`the belief about ${part.name}`, `curl "${api}/beliefs/${link}?iteration=${shown()}"`]);
  if (view.edge) lines.push(["a message", `curl "${api}/messages/${view.edge.map(encodeURIComponent).join("/")}?iteration=${shown()}"`]);
  if (state.viewId) {
    const now = { iteration: view.iteration, part: view.part, particle: view.particle, show: view.show };
    lines.push(["this 3D view shows it", `curl -X PATCH "${api}/views/${state.viewId}" --json '${JSON.stringify(now)}'`]);
  }
  return lines;
}

function show() {
  if (state.tab !== "share" || !state.session) return;
  const api = root(state.id);
  const given = query();
  given.delete("tab");
  find("share-link").value = `${location.origin}/sessions/${state.id}/${given.size ? `?${given}` : ""}`;
  find("share-recording").href = `${api}/recording`;
  find("share-scene").href = `${api}/views/${state.viewId}/scene.html`;
  find("share-picture").href = `${api}/estimate.png?iteration=${shown()}&width=1280`;
  find("share-estimate").href = `${api}/estimate?iteration=${shown()}`;
  find("share-recording").download = "";
  find("share-scene").download = `${state.id}-${shown()}.html`;
  find("share-picture").download = `${state.id}-${shown()}.png`;
  find("share-estimate").download = `${state.id}-${shown()}.json`;
  say(find("share-curl"), commands().map(([what, line]) => `# ${what}\n${line}`).join("\n"));
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
  say(button, "Copied");
  setTimeout(() => say(button, word === "Copied" ? "Copy" : word), 1500);
}

