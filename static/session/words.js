// What do the page's words mean? Each stands once, under the mouse where the word is used and together in the help.

import { byId, h } from "./dom.js";

const WORDS = {
  searching: [
    "searching",
    "Whole objects are tried all over the region; nothing says yet how sure any of them is. Shaded blue in the plots.",
  ],
  settling: ["settling", "One object is left, and its parts move into their best places."],
  rest: [
    "at rest",
    "Another iteration would change nothing: the posterior is read out from here on. Shaded green in the plots.",
  ],
  std: [
    "std",
    "The largest standard deviation of the position about the estimate, given the scan, so it is large, too, where the estimate is at one end of what may be. The mark is the limit up to which a part is certain.",
  ],
  visible: [
    "visible",
    "The share of the part's surface, as the camera would see it alone, that nothing stands before.",
  ],
  certain: [
    "certain",
    "The fit is good, no other hypothesis of more than 1 % has it elsewhere, and it is known to within the limit.",
  ],
  interval: ["90 % within", "The joint is between these positions with a probability of 90 %, given the scan."],
  add: ["ADD", "The mean distance between a part's surface as estimated and where it really is."],
  likelihood: [
    "log likelihood",
    "How well the scan fits the estimate, in nats, at the final tolerance in every iteration: higher is better.",
  ],
  spread: ["spread", "How far the algorithm spreads its particles. It follows its settings, and is no uncertainty."],
  effective: [
    "effective sample size",
    "How many particles of equal weight would tell as much; few means that a few particles have all the weight.",
  ],
  clusters: ["clusters", "Groups among the particles: places where the algorithm is looking."],
  seconds: ["time", "Wall time of an iteration, without reading it out."],
  units: ["units", "Lengths are in centimetres and angles in degrees here; over REST in metres and radians."],
};

export const meaning = (word) => WORDS[word][1];

export function install() {
  for (const place of document.querySelectorAll("[data-word]")) place.title = meaning(place.dataset.word);
  byId("words").replaceChildren(
    ...Object.values(WORDS).map(([word, told]) => h("div", {}, h("dt", {}, word), h("dd", {}, told))),
  );
}
