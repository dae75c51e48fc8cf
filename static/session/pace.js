// When is something asked for? Again where what it depends on has changed, one call at a time, not in a hurry,
// and only while somebody looks; what goes wrong stands as a calm sentence where the answer would.

import { isLive, put, state } from "./state.js";

const PACE = 150; // milliseconds between two calls
const UNDERWAY = 600; // the same while the session iterates: each answer takes time from the inference

// `work` is asked for when `key()` is another than at the last call; `failed` takes the sentence of what went wrong.
export function paced(work, key, failed = () => {}) {
  let done = null;
  let busy = false;
  let timer = null;
  const ask = async () => {
    if (busy || timer || document.hidden) return;
    const wanted = key();
    if (wanted === done) return;
    busy = true;
    try {
      await work();
      failed("");
    } catch (error) {
      if (error.status === 0) put({ lost: true });
      else failed(error.message);
    } finally {
      done = wanted;
      busy = false;
      timer = setTimeout(() => {
        timer = null;
        ask();
      }, isLive() && state.session?.state === "running" ? UNDERWAY : PACE);
    }
  };
  const again = (force) => {
    if (force) done = null;
    return ask();
  };
  document.addEventListener("visibilitychange", () => document.hidden || ask());
  return again;
}
