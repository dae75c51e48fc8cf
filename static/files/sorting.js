// What are files that came together? Models with the meshes they name, scans with their cameras, and what else a session
// is made of, told by names and contents. The rules are in docs/viewer.md.

import { entriesOf, zipped } from "./zip.js";

const MODELS = ["urdf", "xml"];
const SCANS = ["png", "pcd", "ply", "xyz", "txt", "npy", "npz"];
const RECORDINGS = ["sqlite", "sqlite3", "db"];
// What only lies beside a scan: it is of no use here, and no mistake either.
const BESIDE = ["truth.json"];

export const suffix = (path) => path.split(".").pop().toLowerCase();
const nameOf = (path) => path.split("/").pop();
const folderOf = (path) => path.split("/").slice(0, -1).join("/");
// What is left of a name without the words that tell a scan from its camera: depth_3 and camera_3 belong together.
const key = (path) =>
  nameOf(path)
    .toLowerCase()
    .replace(/\.[^.]*$/, "")
    .replace(/depth|camera|cam|scan|cloud|points|image|info|intrinsics|[^a-z0-9]/g, "");

// Of files { path, file }: { uploads: [{ kind, file, camera, path }], priors, regions, refused: [[name, sentence]] },
// models first. `camera` is the text of camera.json, or null.
export async function sorted(files) {
  const found = { uploads: [], priors: [], regions: [], refused: [] };
  const loose = [];
  for (const one of files) {
    if (hidden(one.path)) continue;
    if (suffix(one.path) === "zip") await openZip(one, files.length, loose, found);
    else loose.push(one);
  }
  const models = loose.filter(({ path }) => MODELS.includes(suffix(path)));
  const rest = await withoutMeshes(models, loose, found);
  const cameras = [];
  for (const one of rest.filter(({ path }) => suffix(path) === "json")) await readJson(one, cameras, found);
  for (const { path, file } of rest) {
    const end = suffix(path);
    if (end === "json") continue;
    if (RECORDINGS.includes(end)) found.uploads.push({ kind: "recordings", path, file });
    else if (end === "png" && path.includes("/") && !(await isDepth(file)))
      continue; // a texture, or a photograph
    else if (SCANS.includes(end)) found.uploads.push({ kind: "scans", path, file, camera: cameraOf(path, cameras) });
    else if (!path.includes("/")) found.refused.push([file.name, null]);
  }
  const order = ["models", "scans", "recordings"];
  found.uploads.sort(
    (a, b) => order.indexOf(a.kind) - order.indexOf(b.kind) || a.path.localeCompare(b.path, "en", { numeric: true }),
  );
  found.cameras = cameras;
  return found;
}

const hidden = (path) => path.split("/").some((step) => step.startsWith(".") || step === "__MACOSX");

// What a zip holds beside a model comes out of it; one with a model goes to the server as it is, which finds the meshes.
async function openZip({ path, file }, together, loose, found) {
  let entries;
  try {
    entries = (await entriesOf(file)).filter((entry) => !hidden(entry.path));
  } catch (error) {
    if (together > 1) found.refused.push([file.name, error.message]);
    else found.uploads.push({ kind: "models", path, file }); // the server says what is wrong with it
    return;
  }
  const urdfs = entries.filter((entry) => suffix(entry.path) === "urdf");
  const within = entries.filter((entry) => suffix(entry.path) !== "urdf");
  if (urdfs.length || !within.some((entry) => SCANS.includes(suffix(entry.path)))) {
    found.uploads.push({ kind: "models", path, file });
  }
  let texts = "";
  try {
    for (const urdf of urdfs) texts += await (await urdf.file()).text();
    for (const entry of within) {
      if (![...SCANS, "json"].includes(suffix(entry.path)) || texts.includes(nameOf(entry.path))) continue;
      const taken = { path: `${path}/${entry.path}`, file: await entry.file() };
      if (suffix(entry.path) !== "png" || (await isDepth(taken.file))) loose.push(taken);
    }
  } catch (error) {
    found.refused.push([file.name, error.message]);
  }
}

// A URDF with meshes among the files becomes a zip of both; what is left belongs to no model.
async function withoutMeshes(models, files, found) {
  let rest = files.filter((one) => !models.includes(one));
  const meshes = new Set();
  for (const model of models) {
    const text = await model.file.text();
    const named = [...new Set([...text.matchAll(/filename\s*=\s*["']([^"']+)["']/g)].map((match) => match[1]))];
    const own = rest.filter(({ path }) => named.some((name) => nameOf(name) === nameOf(path)));
    for (const one of own) meshes.add(one);
    // what meshes name themselves, materials and textures, lies beside them
    const folders = new Set(own.map(({ path }) => folderOf(path)));
    const beside = rest.filter(
      (one) =>
        !own.includes(one) &&
        ["mtl", "jpg", "jpeg", "bin"].includes(suffix(one.path)) &&
        folders.has(folderOf(one.path)),
    );
    if (!own.length) found.uploads.push({ kind: "models", path: model.path, file: model.file });
    else {
      const name = nameOf(model.path).replace(/\.[^.]*$/, "");
      const file = await zipped(`${name}.zip`, [
        { ...model, path: asUrdf(model.path) },
        ...own.flatMap((one) => placesOf(one.path, named).map((path) => ({ ...one, path }))),
        ...beside,
      ]);
      found.uploads.push({ kind: "models", path: model.path, file });
    }
  }
  rest = rest.filter((one) => !meshes.has(one));
  return rest;
}

// Where a mesh goes in a model's zip: as it lies in a folder; a file chosen by itself where the model names it.
function placesOf(path, named) {
  const own = named
    .filter((name) => nameOf(name) === path)
    .map((name) => name.replace(/^(package:\/\/[^/]*|\w+:\/)?\/+/, ""));
  const within = own.filter((name) => !name.split("/").includes(".."));
  return within.length ? [...new Set(within)] : [path];
}

const asUrdf = (path) => (suffix(path) === "urdf" ? path : path.replace(/\.[^.]*$/, ".urdf"));

async function readJson({ path, file }, cameras, found) {
  if (BESIDE.includes(nameOf(path))) return;
  const text = await file.text();
  let members = null;
  try {
    members = JSON.parse(text);
  } catch {
    found.refused.push([file.name, `'${file.name}' is not JSON.`]);
    return;
  }
  if (members && "fx" in members) cameras.push({ path, text });
  else if (members && "kind" in members) found.priors.push(text);
  else if (members && Array.isArray(members.roi ?? members.region)) found.regions.push(members.roi ?? members.region);
  else if (!path.includes("/")) {
    const sentence = `'${file.name}' is neither a camera (it has no fx), nor a prior (it has no kind).`;
    found.refused.push([file.name, sentence]);
  }
}

// The camera of a scan: that of its own name; else, in the nearest folder around it where it is one only, that of its name
// without words as "depth" and "camera", or the only one there is.
function cameraOf(path, cameras) {
  const stem = (text) => text.replace(/\.[^.]*$/, "");
  const exact = cameras.filter((camera) => stem(camera.path) === stem(path));
  if (exact.length === 1) return exact[0].text;
  for (let folder = folderOf(path); ; folder = folderOf(folder)) {
    const here = cameras.filter((camera) => !folder || camera.path.startsWith(`${folder}/`));
    const like = here.filter((camera) => key(camera.path) === key(path));
    if (like.length === 1) return like[0].text;
    if (here.length === 1) return here[0].text;
    if (!folder) break;
  }
  return null;
}

// Whether a PNG is a depth image: 16 bit, grey. Any other is a texture or a photograph.
async function isDepth(file) {
  const head = new Uint8Array(await file.slice(0, 26).arrayBuffer());
  return head[24] === 16 && head[25] === 0;
}
