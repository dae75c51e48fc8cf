// Which sessions has this browser had open? One that it has not is played when its card is pressed.

import { recall, remember } from "./remembered.js";

const KEY = "sessions seen";
const MOST = 500; // the oldest are forgotten

const kept = () => recall(KEY, []);

export const wasSeen = (id) => kept().includes(id);

export function see(id) {
  const others = kept().filter((one) => one !== id);
  remember(KEY, [...others, id].slice(-MOST));
}
