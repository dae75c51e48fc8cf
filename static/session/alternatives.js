// Where else may the object be? The posterior's hypotheses of the whole object, and in words what each has elsewhere.

import { byId, h } from "./dom.js";
import { centimetres, DEGREES, degrees, joint, percent } from "./format.js";
import { angle, distance } from "./pose.js";

// Nearer than this in all it is the estimate's own mode, metres; a turn counts as what moves this far from the axis,
// metres; turns smaller than this are not worth a word, radians.
const SAME = 0.005;
const ARM = 0.2;
const TURNED = 5 / DEGREES;

export function showAlternatives(estimate) {
  const { alternatives } = estimate;
  byId("alternatives").hidden = alternatives.length < 2;
  byId("alternatives-list").replaceChildren(
    ...(alternatives.length < 2 ? [] : alternatives).map((other) =>
      h("li", {}, [
        h("span", { class: "weight", css: { "--share": other.weight }, "aria-hidden": "true" }),
        h("span", { class: "figure" }, percent(other.weight, other.weight < 0.1 ? 1 : 0)),
        h("span", { class: "what" }, whatDiffers(estimate, other)),
      ]),
    ),
  );
}

// What is farthest from the estimate: the link that has moved most, and the joint, by share of its range.
export function whatDiffers(estimate, other) {
  const links = Object.entries(other.links).map(([name, { pose }]) => {
    const here = estimate.links[name].pose;
    const far = distance(pose.position, here.position);
    const turn = angle(pose.orientation, here.orientation);
    return { name, far, turn, moved: far + ARM * turn };
  });
  const link = links.reduce((most, one) => (one.moved > most.moved ? one : most));
  if (link.moved < SAME) return "as estimated";
  const turned = link.turn > TURNED ? `, turned by ${degrees(link.turn, 0)}` : "";
  const words = [`${link.name} ${centimetres(link.far)} away${turned}`];
  const joints = Object.entries(estimate.joints)
    .filter(([, one]) => !Array.isArray(one.position))
    .map(([name, one]) => ({ name, ...one, moved: Math.abs(other.joints[name] - one.position) }))
    .map((one) => ({ ...one, share: one.moved / (one.upper - one.lower || 1) }));
  const most = joints.reduce((far, one) => (one.share > far.share ? one : far), { share: 0.01 });
  if (most.name)
    words.push(`${most.name} at ${joint(most.type, other.joints[most.name])}, not ${joint(most.type, most.position)}`);
  return words.join("; ");
}
