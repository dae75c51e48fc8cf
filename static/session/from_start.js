// A session that is opened to be watched, with `?play` in the page's address, is played from its first iteration. One
// that was just made, with `?play=run`, is run by its page: the first particles are in the scene before an iteration is
// made, so that the page and the inference do not wait for each other's processor.

import { run } from "./controls.js";
import { drawn } from "./scene_frame.js";
import { isRecording, newestIteration, oldestIteration, state } from "./state.js";
import { follow } from "./timeline.js";

const PATIENCE = 8000; // milliseconds: a browser that draws no scene shows its numbers

const wish = (search) => new URLSearchParams(search).get("play");
export const asked = (search) => wish(search) !== null;

export async function watch(search) {
  await Promise.race([drawn, new Promise((resolve) => setTimeout(resolve, PATIENCE))]);
  const untouched = newestIteration() === 0 && !isRecording() && state.session.state === "paused";
  if (wish(search) === "run" && untouched) run({ until: "converged" });
  else follow(oldestIteration());
}
