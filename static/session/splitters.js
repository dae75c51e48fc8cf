// How is the room shared out? The panel is as wide, and the plots are as high, as somebody drags them; the browser
// remembers it.

import { byId } from "./dom.js";
import { recall, remember } from "./remembered.js";

const STEP = 24; // pixels, for a key
const KEY = "room on the session page";

// Each: the style's property, its least and most in pixels, and what the place of the pointer makes of it.
const SPLITTERS = [
  {
    id: "split-side",
    property: "--side",
    ends: () => [300, Math.max(300, innerWidth * 0.6)],
    measure: () => byId("details").getBoundingClientRect().width,
    at: ({ clientX }) => innerWidth - clientX,
    keys: { ArrowLeft: STEP, ArrowRight: -STEP },
  },
  {
    id: "split-strip",
    property: "--plot",
    ends: () => [70, Math.max(70, innerHeight * 0.5)],
    measure: () => byId("plots").querySelector(".plot:not([hidden])")?.clientHeight ?? 0,
    at: ({ clientY }, grip) => grip.measure() + byId("split-strip").getBoundingClientRect().top - clientY,
    keys: { ArrowUp: STEP, ArrowDown: -STEP },
  },
];

const kept = () => recall(KEY, {});

export function install() {
  const before = kept();
  for (const grip of SPLITTERS) {
    const place = byId(grip.id);
    if (Number.isFinite(before[grip.property])) set(grip, before[grip.property]);
    place.addEventListener("pointerdown", (event) => drag(grip, place, event));
    place.addEventListener("keydown", (event) => {
      const by = grip.keys[event.key];
      if (!by) return;
      event.preventDefault();
      event.stopPropagation(); // the arrows move through the iterations elsewhere
      keep(grip, set(grip, grip.measure() + by));
    });
    place.addEventListener("dblclick", () => forget(grip));
    tell(grip, grip.measure());
    new ResizeObserver(() => tell(grip, grip.measure())).observe(document.body);
  }
}

function set(grip, wanted) {
  const [least, most] = grip.ends();
  const pixels = Math.round(Math.min(most, Math.max(least, wanted)));
  document.body.style.setProperty(grip.property, `${pixels}px`);
  tell(grip, pixels);
  return pixels;
}

function tell(grip, pixels) {
  const [least, most] = grip.ends();
  const told = { "aria-valuemin": least, "aria-valuemax": most, "aria-valuenow": pixels };
  for (const [name, value] of Object.entries(told)) byId(grip.id).setAttribute(name, String(Math.round(value)));
}

function drag(grip, place, event) {
  event.preventDefault();
  place.focus();
  place.setPointerCapture(event.pointerId); // the 3D view beside it would swallow the pointer
  let pixels = grip.measure();
  const move = (moved) => {
    pixels = set(grip, grip.at(moved, grip));
  };
  const end = () => {
    place.removeEventListener("pointermove", move);
    keep(grip, pixels);
  };
  place.addEventListener("pointermove", move);
  place.addEventListener("lostpointercapture", end, { once: true });
}

const keep = (grip, pixels) => remember(KEY, { ...kept(), [grip.property]: pixels });

function forget(grip) {
  document.body.style.removeProperty(grip.property);
  keep(grip, null);
  tell(grip, grip.measure());
}
