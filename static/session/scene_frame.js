// The frame with the 3D view, begun before all else of the page: its program takes the browser longest to start. Which
// view it shows, and whether the processor draws it, is known without the server.

import { call, sessionPath } from "./api.js";
import { byId } from "./dom.js";
import { withoutGraphicsCard } from "./graphics.js";
import { theme } from "./state.js";
import { randomId } from "./view_id.js";

const asked = new URLSearchParams(location.search);

export const sessionId = decodeURIComponent(location.pathname.split("/")[2]);
// A tab's view keeps its name when it is loaded again, and another tab has another one.
export const viewId = nameOfView();
// Whether little is drawn: there is no graphics card, or somebody asked for it.
export const sparing = asked.has("economy") ? asked.get("economy") !== "0" : withoutGraphicsCard();

const frame = byId("scene");
// Resolves once the browser has drawn particles or points of the scan in it.
export const drawn = new Promise((resolve) => {
  frame.addEventListener("drawn", resolve, { once: true });
});
// What the view is said to be, by which the server makes its first picture ready while the frame still loads.
export const opened = call(`${sessionPath(sessionId)}/views/${viewId}`, { method: "PATCH", body: first() });
opened.catch(() => {}); // whoever awaits it hears of it

let loaded = false;
frame.addEventListener("load", () => {
  loaded = true;
});

begin();

// Load the 3D view, also anew.
export function begin() {
  frame.src = `/sessions/${encodeURIComponent(sessionId)}/view/${viewId}/${sparing ? "?economy" : ""}`;
}

// Call `act` with the frame's window, which is another one each time it is loaded.
export function eachLoad(act) {
  if (loaded) act(frame.contentWindow);
  frame.addEventListener("load", () => act(frame.contentWindow));
}

// There is nothing to be shown.
export function end() {
  frame.removeAttribute("src");
}

function first() {
  const whole = { theme: theme(), hidden: document.hidden, economy: sparing };
  return asked.has("play") ? { ...whole, iteration: 0 } : whole;
}

function nameOfView() {
  const key = `view of ${sessionId}`;
  const wish = asked.get("view");
  if (wish && /^[A-Za-z0-9_-]{1,64}$/.test(wish)) return wish;
  const name = sessionStorage.getItem(key) ?? randomId();
  sessionStorage.setItem(key, name);
  return name;
}
