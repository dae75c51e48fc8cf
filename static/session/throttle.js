// When is something asked for? Again where what it depends on has changed, one call at a time, not in a hurry,
// and only while somebody looks; what goes wrong stands as a calm sentence where the answer would.

import { goesOn, update } from "./state.js";

const PACE = 150; // milliseconds between two calls
const UNDERWAY = 600; // the same while iterations come by themselves: each answer takes time from the inference

// `work` is asked for when `key()` is another than at the last call; `onError` takes the sentence of what went wrong.
export function throttled(work, key, onError = () => {}) {
  let lastKey = null;
  let busy = false;
  let timer = null;
  const ask = async () => {
    if (busy || timer || document.hidden) return;
    const currentKey = key();
    if (currentKey === lastKey) return;
    busy = true;
    try {
      await work();
      onError("");
    } catch (error) {
      if (error.status === 0) update({ lost: true });
      else onError(error.message);
    } finally {
      lastKey = currentKey;
      busy = false;
      timer = setTimeout(
        () => {
          timer = null;
          ask();
        },
        goesOn() ? UNDERWAY : PACE,
      );
    }
  };
  const again = (force) => {
    if (force) lastKey = null;
    return ask();
  };
  document.addEventListener("visibilitychange", () => document.hidden || ask());
  return again;
}
