// How does a scan come from a file into the session? As on the start page: with the camera that came along, then to the
// server, then into the session.

import { chosen } from "../files/dropped.js";
import { sorted } from "../files/sorting.js";
import { call, sessionPath } from "./api.js";
import { state, update } from "./state.js";

// Sends the files of an <input> to the server, one after the other, and gives the scans that they have become. What is no
// scan is refused by a sentence, and so is a depth image without a camera.
export async function sendFiles(input) {
  const files = chosen(input);
  input.value = ""; // the same file can be chosen again
  const found = await sorted(files);
  const scans = found.uploads.filter(({ kind }) => kind === "scans");
  for (const [name, sentence] of found.refused) throw new Error(sentence ?? `'${name}' is no scan.`);
  if (!scans.length) throw new Error("There is no scan among these files: choose a depth image or a point cloud.");
  const sent = [];
  for (const { file, camera } of scans) sent.push(await send(file, camera));
  return sent;
}

// Lets the session go on with a scan of the server; `mode` as the server has it.
export async function add(scan_id, mode) {
  const session = await call(`${sessionPath(state.id)}/scans`, { method: "POST", body: { scan_id, mode } });
  update({ session: { ...state.session, scan_ids: session.scan_ids } });
}

function send(file, camera) {
  const form = new FormData();
  if (camera) form.append("camera", camera);
  form.append("file", file, file.name);
  return call("/api/v1/scans", { method: "POST", body: form });
}
