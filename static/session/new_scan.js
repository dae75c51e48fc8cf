// How does the session go on with another scan? One of those on the server, or from a file, as another view of the same
// scene or as what the scene looks like now; it counts from the next iteration on. Nothing is added before somebody has
// chosen a scan and pressed the button, and each press needs a choice of its own.

import { add, sendFiles } from "./add_files.js";
import { call } from "./api.js";
import { byId, h, sentence, setText } from "./dom.js";
import { isGone, isRecording, state, subscribe } from "./state.js";

const NONE = h("option", { value: "" }, "choose a scan");
const wrong = sentence("new-scan-error");
const tell = sentence("new-scan-told");

let shown = "";
let scans = []; // all on the server, oldest first
let busy = false; // whether a file or a scan is on its way

export function install() {
  byId("new-scan").addEventListener("submit", (event) => {
    event.preventDefault();
    during(addChosen);
  });
  byId("new-scan-files").addEventListener("change", ({ target }) => during(() => take(target)));
  byId("new-scan-id").addEventListener("change", () => {
    tell("");
    allow();
  });
  subscribe(["tab", "session"], show);
}

async function show() {
  byId("new-scan").hidden = isRecording();
  allow();
  if (state.tab !== "settings" || isRecording() || isGone()) {
    shown = ""; // asked for again when somebody comes back: others may have been uploaded
    return;
  }
  if (shown === String(state.session?.scan_ids)) return;
  shown = String(state.session?.scan_ids);
  try {
    await list();
  } catch (problem) {
    wrong(problem.message);
  }
}

// Offers the scans of the server, newest first, but for those in force.
async function list() {
  scans = await call("/api/v1/scans");
  const inForce = state.session?.scan_ids ?? [];
  const others = scans.filter((scan) => !inForce.includes(scan.id)).reverse();
  const before = byId("new-scan-id").value;
  byId("new-scan-id").replaceChildren(NONE, ...others.map(({ id }) => h("option", { value: id }, named(id))));
  setText(NONE, others.length ? "choose a scan" : "none: choose a file");
  choose(before);
  setText(byId("scans-in-force"), `In force: ${inForce.map(named).join("; ")}.`);
}

// A scan by its file's name and when it came, with the id where another one has both.
function named(id) {
  const words = ({ file_name: name, created }) => `${name}, ${new Date(created).toLocaleString("en-GB")}`;
  const scan = scans.find((one) => one.id === id);
  if (!scan) return id;
  const alike = scans.filter((one) => words(one) === words(scan)).length > 1;
  return alike ? `${words(scan)}, ${id}` : words(scan);
}

function choose(id) {
  const select = byId("new-scan-id");
  select.value = [...select.options].some((option) => option.value === id) ? id : "";
  allow();
}

function allow() {
  byId("new-scan-add").disabled = busy || isGone() || !byId("new-scan-id").value;
  for (const id of ["new-scan-id", "new-scan-files"]) byId(id).disabled = busy || isGone();
}

// The files go to the server alone: what they show is told before the button is pressed.
async function take(input) {
  tell("On its way to the server…");
  const sent = await sendFiles(input);
  await list();
  choose(sent[0].id);
  const names = sent.map(({ id }) => named(id)).join("; ");
  tell(`On the server, and not yet in this session: ${names}.`);
}

async function addChosen() {
  const scan = byId("new-scan-id").value;
  const mode = byId("new-scan").elements.mode.value;
  if (!scan) return;
  const name = named(scan);
  await add(scan, mode);
  choose("");
  const what = mode === "replaces" ? "has replaced the scans before" : "was added as another view";
  tell(`${name}, ${what}. It counts from the next iteration on.`);
}

async function during(work) {
  busy = true;
  allow();
  wrong("");
  tell("");
  try {
    await work();
  } catch (problem) {
    tell("");
    wrong(problem.message);
  }
  busy = false;
  allow();
}
