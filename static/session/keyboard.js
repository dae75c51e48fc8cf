// Which keys do something? Those that no control under the focus takes for itself; in the 3D view too, but for the keys
// it moves its camera with.

import { playOrPause, step } from "./controls.js";
import { byId } from "./dom.js";
import { look } from "./overlays.js";
import { eachLoad } from "./scene_frame.js";
import * as setup from "./setup.js";
import { isRecording } from "./state.js";
import { live, move, playback } from "./timeline.js";

const TAKES_ALL = "input, select, textarea, [contenteditable]";
const TAKES_SPACE = "button, summary, a, [role=button], [role=tab]";
const TAKES_ARROWS = "[role=tab]";
const OF_THE_SCENE = [" ", "l", "?", "f", "c", "t", "escape"];

export function install() {
  document.addEventListener("keydown", press);
  eachLoad((frame) => {
    try {
      frame.addEventListener("keydown", (event) => {
        if (OF_THE_SCENE.includes(event.key.toLowerCase())) press(event);
      });
    } catch {
      // the frame shows an error page of the browser's own: no keys there
    }
  });
  byId("help-open").addEventListener("click", () => byId("help").showModal());
}

function press(event) {
  // a dialog that was just closed may still have the focus
  const target = event.target.closest?.("dialog:not([open])") ? document.body : event.target;
  if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
  if (event.key === "Escape" && setup.isOpen()) setup.close(); // also from a field
  const slides = target.matches?.("input[type=range]");
  if (!slides && target.matches?.(TAKES_ALL)) {
    if (!(target.type === "checkbox" && event.key !== " ")) return;
  }
  if (event.key === " " && target.closest?.(TAKES_SPACE)) return;
  if (event.key.startsWith("Arrow") && (target.closest?.(TAKES_ARROWS) || (slides && target.id !== "slider"))) return;
  const far = event.shiftKey ? 10 : 1;
  const acts = {
    " ": () => (isRecording() ? playback() : playOrPause()),
    ArrowLeft: () => move(-far),
    ArrowRight: () => move(far),
    l: live,
    L: live,
    s: step,
    S: step,
    f: () => look("fit"),
    F: () => look("fit"),
    c: () => look("sensor"),
    C: () => look("sensor"),
    t: () => look("top"),
    T: () => look("top"),
    "?": () => byId("help").showModal(),
  };
  const act = acts[event.key];
  // while it is asked where the object is, nothing runs but by the answer
  if (!act || (setup.isOpen() && event.key !== "?")) return;
  event.preventDefault();
  act();
}
