// How do files come in? Chosen or dropped, told apart by `files/sorting.js`; one after the other, each with a bar that
// shows how much of it has been sent, then with what the server read or its own sentence.

import { chosen, dropped } from "../files/dropped.js";
import { sorted } from "../files/sorting.js";
import { byId, copyOf, setAttributes, setName, setText } from "../session/dom.js";
import { trouble } from "./confirm.js";
import { aboutModel, aboutRecording, aboutScan, bytes } from "./format.js";
import { chooseModel, chooseScan, chooseScans, setPrior, setRegion } from "./new_session.js";
import { refresh } from "./stored.js";

const ABOUT = { models: aboutModel, scans: aboutScan, recordings: aboutRecording };
const KNOWN =
  "a URDF or zip, a scan (PNG, PCD, PLY, XYZ, NPY, NPZ), a camera.json or prior.json, or a recording (SQLite)";

let queue = Promise.resolve();

export function takeFiles() {
  const drop = byId("drop");
  for (const input of [byId("files"), byId("folder")]) {
    input.addEventListener("change", () => {
      take(chosen(input));
      input.value = ""; // the same file can be chosen again
    });
  }
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
    dropped(event.dataTransfer).then(take);
  });
  byId("camera-text").addEventListener("input", aboutCamera);
  aboutCamera();
}

// Files { path, file } that came together. Those of a whole session open it, where nothing else is asked for.
async function take(files) {
  const found = await sorted(files);
  if (found.cameras.length === 1) {
    byId("camera-text").value = found.cameras[0].text; // of scans to come, too
    aboutCamera();
    for (const row of byId("uploads").children) if (row.cameraless) row.querySelector(".again").click();
  }
  for (const text of found.priors) setPrior(text);
  for (const box of found.regions) setRegion(box);
  for (const [name, sentence] of found.refused) {
    refuse(addRow(name), sentence ?? `'${name}' is none of the files this page takes: ${KNOWN}.`, false);
  }
  const alone = found.uploads.length === 1 && files.length === 1;
  const coming = found.uploads.map(({ kind, path, file, camera }) => enqueue(addRow(path), kind, file, camera, alone));
  const kinds = new Set(found.uploads.map(({ kind }) => kind));
  if (found.refused.length || !kinds.has("models") || !kinds.has("scans")) return;
  const entries = await Promise.all(coming);
  if (!entries.every(Boolean) || byId("advanced").open) return;
  chooseScans(entries.filter((_, at) => found.uploads[at].kind === "scans").map(({ id }) => id));
  byId("create").requestSubmit();
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

function addRow(path) {
  const row = copyOf("upload");
  setName(row.querySelector(".file"), path);
  row.querySelector("progress").setAttribute("aria-label", `Upload of ${path}`);
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

// The server's entry, or null where it was not taken in at the first try.
function enqueue(row, kind, file, camera, alone) {
  trouble(row.querySelector(".trouble"), "");
  away(row, "Cancel");
  setAttributes(row, { "data-state": "waiting" });
  row.cameraless = false;
  setText(row.querySelector(".progress-word"), "waiting");
  const done = queue.then(async () => {
    if (row.gone) return null;
    const text = camera ?? byId("camera-text").value.trim();
    try {
      const entry = await send(row, kind, file, text);
      await landed(row, kind, file, entry, alone);
      return entry;
    } catch (problem) {
      const again = refuse(row, problem.message);
      row.cameraless = kind === "scans" && !text;
      again.onclick = () => enqueue(row, kind, file, undefined, alone);
      return null;
    }
  });
  queue = done;
  return done;
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
  trouble(byId("create-trouble"), ""); // it may have been that this was missing
  if (kind === "models") chooseModel(entry.id);
  if (kind === "scans") chooseScan(entry.id);
  setAttributes(row, { "data-state": "done" });
  row.querySelector("progress").value = 1;
  setText(row.querySelector(".progress-word"), bytes(file.size));
  const result = row.querySelector(".result");
  setText(result, ABOUT[kind](entry));
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
