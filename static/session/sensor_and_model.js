// How noisy are the depths, and of how many pixels at once, and what have sensor and model wrong everywhere? Rows of
// texts: what it is, what it is taken for, how sure that is, and how sure it was before the scan.

import { degrees, fineCentimetres, percent } from "./format.js";

const AXES = { rx: "turn about x", ry: "turn about y", rz: "turn about z" };

export function sensorAndModel({ depth_noise: noise, depth_noise_area: areas, depth_distortion: smooth, nuisances }) {
  const many = noise.length > 1;
  const view = (index) => (many ? `, view ${index}` : "");
  const together = (area) => (area > 1 ? `, ${area.toFixed(1)} pixels as one` : "");
  const depths = noise.map((std, index) =>
    std === null
      ? [`depth noise${view(index)}`, "–", "nothing of the region in it", ""]
      : [`depth noise${view(index)}${together(areas[index])}`, "–", `± ${fineCentimetres(std)}`, ""],
  );
  const distortions = smooth.flatMap((std, index) =>
    std > 0 ? [[`depth distortion${view(index)}`, "–", `± ${fineCentimetres(std)}`, ""]] : [],
  );
  const others = Object.entries(nuisances).map(([name, { value, std, prior_std: before }]) => {
    const [kind, ...rest] = name.split("/"); // a part's name may have a slash itself
    if (kind === "camera") {
      const [of, axis] = rest;
      const write = axis in AXES ? degrees : fineCentimetres;
      return [`camera ${of}, ${AXES[axis] ?? axis}`, write(value, 2), `± ${write(std, 2)}`, `± ${write(before, 2)}`];
    }
    const what = kind === "size" ? `size of ${rest.join("/")}` : `depth scale${view(rest[0])}`;
    return [what, percent(value, 2), `± ${percent(std, 2)}`, `± ${percent(before, 2)}`];
  });
  return [...depths, ...distortions, ...others];
}
