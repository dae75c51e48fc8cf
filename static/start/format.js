// How are sizes, times and counts written on the start page? As in any list of files.

const COUNT = new Intl.NumberFormat("en", { useGrouping: true });
const TIME = new Intl.DateTimeFormat("en-GB", { day: "numeric", month: "short", hour: "2-digit", minute: "2-digit" });

export const grouped = (number) => COUNT.format(number).replaceAll(",", "\u202f");
export const count = (number, one) => `${grouped(number)} ${number === 1 ? one : `${one}s`}`;

export function bytes(number) {
  if (number < 1000) return `${number} B`;
  const [size, unit] = number < 1e6 ? [number / 1e3, "kB"] : number < 1e9 ? [number / 1e6, "MB"] : [number / 1e9, "GB"];
  return `${size.toFixed(size < 10 ? 1 : 0)} ${unit}`;
}

export function when(text) {
  const date = new Date(text ?? NaN);
  return Number.isNaN(date.valueOf()) ? "" : TIME.format(date);
}

export function aboutModel(model) {
  const { links, joints, parts } = model;
  return `${count(links.length, "link")}, ${count(joints.length, "joint")}, ${count(parts.length, "part")}`;
}

export function aboutScan(scan) {
  return `${count(scan.points, "point")}, ${scan.camera.width} × ${scan.camera.height}`;
}

export function aboutRecording(recording) {
  return `${recording.model}, ${count(recording.iterations, "iteration")}`;
}
