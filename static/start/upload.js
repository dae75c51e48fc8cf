// How do files come in? Chosen or dropped, told apart by their names and, for JSON, by what is in them; one after the
// other, each with a bar that shows how much of it has been sent, then with what the server read or its own sentence.

import { byId, copyOf, setAttributes, setText } from "../session/dom.js";
import { trouble } from "./confirm.js";
import { aboutModel, aboutRecording, aboutScan, bytes } from "./format.js";
import { chooseModel, chooseScan, setPrior, setRegion } from "./new_session.js";
import { refresh } from "./stored.js";

const KINDS = {
  models: { suffixes: ["urdf", "xml", "zip"], about: aboutModel },
  scans: { suffixes: ["png", "pcd", "ply", "xyz", "txt", "npy", "npz"], about: aboutScan },
  recordings: { suffixes: ["sqlite", "sqlite3", "db"], about: aboutRecording },
};
const KNOWN =
  "a URDF or zip, a scan (PNG, PCD, PLY, XYZ, NPY, NPZ), a camera.json or prior.json, or a recording (SQLite)";

let queue = Promise.resolve();

export function takeFiles() {
  const drop = byId("drop");
  const input = byId("files");
  input.addEventListener("change", () => {
    take([...input.files]);
    input.value = ""; // the same file can be chosen again
  });
  // Beside the drop zone too: a browser would leave the page to show a file that missed it.
  let over = 0;
  const mark = (change) => {
    over = Math.max(0, over + change);
    setAttributes(drop, { "data-over": over > 0 });
  };
  const carries = (event) => event.dataTransfer?.types.includes("Files");
  addEventListener("dragenter", (event) => carries(event) && mark(1));
  addEventListener("dragleave", (event) => carries(event) && mark(-1));
  addEventListener("dragover", (event) => carries(event) && event.preventDefault());
  addEventListener("drop", (event) => {
    if (!carries(event)) return;
    event.preventDefault();
    mark(-over);
    take([...event.dataTransfer.files]);
  });
  byId("camera-text").addEventListener("input", aboutCamera);
  aboutCamera();
}

async function take(files) {
  const cameras = new Map();
  const others = [];
  for (const file of files) {
    if (suffix(file) === "json") await readJson(file, cameras);
    else others.push(file);
  }
  // models first: a scan alone makes no session
  const order = Object.keys(KINDS);
  const known = others.map((file) => [kindOf(file), file]);
  known.sort(([a], [b]) => order.indexOf(a) - order.indexOf(b));
  for (const [kind, file] of known) {
    const row = addRow(file);
    if (!kind) refuse(row, `'${file.name}' is none of the files this page takes: ${KNOWN}.`, false);
    else enqueue(row, kind, file, cameras.get(stem(file)), files.length === 1);
  }
}

function kindOf(file) {
  return Object.keys(KINDS).find((kind) => KINDS[kind].suffixes.includes(suffix(file)));
}

const suffix = (file) => file.name.split(".").pop().toLowerCase();
const stem = (file) => file.name.replace(/\.[^.]*$/, "");

// A camera goes with the scan of the same name, else with all scans from now on.
async function readJson(file, cameras) {
  const text = await file.text();
  let members = null;
  try {
    members = JSON.parse(text);
  } catch {
    refuse(addRow(file), `'${file.name}' is not JSON.`, false);
    return;
  }
  if (members && "fx" in members) {
    cameras.set(stem(file), text);
    byId("camera-text").value = text;
    aboutCamera();
  } else if (members && "kind" in members) setPrior(text);
  else if (members && Array.isArray(members.roi ?? members.region)) setRegion(members.roi ?? members.region);
  else refuse(addRow(file), `'${file.name}' is neither a camera (it has no fx), nor a prior (it has no kind).`, false);
}

function aboutCamera() {
  const text = byId("camera-text").value.trim();
  let about = text ? "not JSON" : "none";
  try {
    if (text) about = `${JSON.parse(text).width} × ${JSON.parse(text).height} pixels`;
  } catch {
    // being typed
  }
  setText(byId("camera-about"), about);
}

function addRow(file) {
  const row = copyOf("upload");
  setText(row.querySelector(".file"), file.name);
  row.querySelector("progress").setAttribute("aria-label", `Upload of ${file.name}`);
  row.querySelector(".away").addEventListener("click", () => {
    row.request?.abort();
    row.gone = true;
    row.remove();
    byId("files").focus();
  });
  away(row, "Cancel");
  byId("uploads").append(row);
  return row;
}

function away(row, word) {
  const button = row.querySelector(".away");
  button.title = word;
  button.setAttribute("aria-label", `${word} ${row.querySelector(".file").textContent}`);
}

function enqueue(row, kind, file, camera, alone) {
  trouble(row.querySelector(".trouble"), "");
  away(row, "Cancel");
  setAttributes(row, { "data-state": "waiting" });
  setText(row.querySelector(".progress-word"), "waiting");
  queue = queue.then(async () => {
    if (row.gone) return;
    const text = camera ?? byId("camera-text").value.trim();
    try {
      await landed(row, kind, file, await send(row, kind, file, text), alone);
    } catch (problem) {
      const again = refuse(row, problem.message);
      again.onclick = () => enqueue(row, kind, file, undefined, alone);
    }
  });
}

// XMLHttpRequest, as fetch tells nothing of how much has been sent.
function send(row, kind, file, camera) {
  const form = new FormData();
  if (kind === "scans" && camera) form.append("camera", camera);
  form.append("file", file, file.name);
  const bar = row.querySelector("progress");
  const word = row.querySelector(".progress-word");
  const request = new XMLHttpRequest();
  row.request = request;
  setAttributes(row, { "data-state": "sending" });
  setAttributes(row.querySelector(".again"), { hidden: true });
  bar.value = 0;
  return new Promise((done, fail) => {
    request.upload.onprogress = (event) => {
      if (!event.lengthComputable) return;
      const share = event.loaded / event.total;
      bar.value = share;
      setText(word, share < 1 ? `${Math.floor(100 * share)} % of ${bytes(event.total)}` : "being read");
    };
    request.upload.onload = () => setText(word, "being read");
    request.onerror = () => fail(new Error("The server does not answer; the file was not taken in."));
    request.onabort = () => fail(new Error("Cancelled."));
    request.onload = () => {
      const { status, response } = request;
      if (status === 201 && response) done(response);
      else fail(new Error(response?.detail ?? `The server answered with ${status}.`));
    };
    request.open("POST", `/api/v1/${kind}`);
    request.responseType = "json";
    request.send(form);
  });
}

// What is said to be there is chosen already: who goes on at once goes on with it.
async function landed(row, kind, file, entry, alone) {
  await refresh([kind]);
  if (kind === "models") chooseModel(entry.id);
  if (kind === "scans") chooseScan(entry.id);
  setAttributes(row, { "data-state": "done" });
  row.querySelector("progress").value = 1;
  setText(row.querySelector(".progress-word"), bytes(file.size));
  const result = row.querySelector(".result");
  setText(result, KINDS[kind].about(entry));
  result.hidden = false;
  away(row, "Dismiss");
  if (kind === "recordings") {
    const link = row.querySelector(".go");
    link.href = `/sessions/${entry.id}/`;
    link.hidden = false;
    if (alone) location.assign(link.href);
  }
}

// Shows why not; returns the button that tries again, which is there where that may help.
function refuse(row, sentence, mayHelp = true) {
  setAttributes(row, { "data-state": "refused" });
  setText(row.querySelector(".progress-word"), "not taken in");
  trouble(row.querySelector(".trouble"), sentence);
  away(row, "Dismiss");
  const again = row.querySelector(".again");
  again.hidden = !mayHelp;
  return again;
}
