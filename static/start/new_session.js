// What is a new session made of? A form over what the server keeps; its members are those of POST /api/v1/sessions. Where
// the object stands is asked on the session's page, in the 3D view.

import { call } from "../session/api.js";
import { byId, h, reconcile, setText } from "../session/dom.js";
import { exact } from "../session/format.js";
import { trouble } from "./confirm.js";
import { aboutScan, count, when } from "./format.js";
import { onChange, openNew, SETUP, stored } from "./stored.js";

const NUMBERS = ["particles", "iterations", "seed"];

let defaults = null; // the options' own, on their way

const region = () => [...byId("region").querySelectorAll("input")];
const chosen = () => [...byId("scan-choices").querySelectorAll("input:checked")].map((box) => box.value);
const priorKind = () => byId("create").elements.prior.value;

export async function fillForm() {
  onChange(() => {
    fillModels();
    fillScans();
  });
  byId("create").addEventListener("submit", create);
  byId("create").addEventListener("change", about);
  byId("bounds").addEventListener("click", useBounds);
  byId("no-region").addEventListener("click", () => setRegion([]));
  byId("prior-file").addEventListener("change", async (event) => {
    const [file] = event.target.files;
    if (file) setPrior(await file.text());
  });
  defaults = call("/api/v1/settings").catch(() => ({ options: [] }));
  for (const { name, default: value, low, high } of (await defaults).options) {
    if (!NUMBERS.includes(name)) continue;
    const input = byId(name);
    input.min = low;
    input.max = Math.min(high, Number.MAX_SAFE_INTEGER);
    input.value ||= value;
  }
  about();
}

function about() {
  byId("gaussian").hidden = priorKind() !== "gaussian";
  const word = (id) => byId(id).selectedOptions[0].textContent;
  const numbers = `${byId("particles").value} particles, ${byId("iterations").value} iterations`;
  setText(byId("inference-about"), `${word("method")}, ${word("preset")}, ${numbers}`);
}

function fillModels() {
  const select = byId("model");
  const before = select.value;
  const options = stored.models.map((model) =>
    h("option", { value: model.id }, `${model.name} · ${count(model.parts.length, "part")} · ${when(model.created)}`),
  );
  select.replaceChildren(...(options.length ? options : [h("option", { value: "" }, "none yet: drop a URDF above")]));
  if (stored.models.some((model) => model.id === before)) select.value = before;
}

function fillScans() {
  byId("no-scans").hidden = stored.scans.length > 0;
  reconcile(
    byId("scan-choices"),
    "scan-choice",
    stored.scans,
    (scan) => scan.id,
    (item, scan) => {
      item.querySelector("input").value = scan.id;
      setText(item.querySelector("b"), scan.file_name);
      setText(item.querySelector("span span"), `${aboutScan(scan)} · ${when(scan.created)}`);
    },
  );
}

export function chooseModel(id) {
  byId("model").value = id;
}

export function chooseScan(id) {
  const box = [...byId("scan-choices").querySelectorAll("input")].find((input) => input.value === id);
  if (box) box.checked = true;
}

// These, and no others.
export function chooseScans(ids) {
  for (const box of byId("scan-choices").querySelectorAll("input")) box.checked = ids.includes(box.value);
}

export function setPrior(text) {
  let members = null;
  try {
    members = JSON.parse(text);
  } catch {
    // shown as it is; `create` says what is wrong
  }
  const kind = members?.kind === "uniform" ? (members.orientation ?? "upright") : "gaussian";
  byId("create").elements.prior.value = kind === "any" ? "any" : kind === "gaussian" ? "gaussian" : "upright";
  if (kind === "gaussian") byId("prior-text").value = text;
  about();
}

// numbers: metres, as the server has them
export function setRegion(numbers) {
  for (const [place, input] of region().entries()) {
    const number = numbers[place];
    input.value = Number.isFinite(number) ? exact(number * 100) : "";
  }
}

function useBounds() {
  const ids = chosen();
  const boxes = stored.scans.filter((scan) => ids.includes(scan.id)).map((scan) => scan.bounds);
  if (!boxes.length) return trouble(byId("create-trouble"), "Choose a scan first, whose bounds are to be taken.");
  trouble(byId("create-trouble"), "");
  const most = (place) => (place < 3 ? Math.min : Math.max)(...boxes.map((box) => box[place]));
  setRegion([0, 1, 2, 3, 4, 5].map((place) => Number(most(place).toFixed(3))));
}

// The members that the server takes. Throws what is missing, where only the page can know it.
function members() {
  const scan_ids = chosen();
  if (!byId("model").value) throw new Error("A model is missing: drop a URDF, or a zip that holds one and its meshes.");
  if (!scan_ids.length) throw new Error("A scan is missing: choose one, or drop a depth image or a point cloud.");
  const asked = { model_id: byId("model").value, scan_ids, method: byId("method").value };
  if (byId("name").value.trim()) asked.name = byId("name").value.trim();
  for (const name of NUMBERS) {
    const input = byId(name);
    if (!input.checkValidity()) throw new Error(`${input.labels[0].textContent}: ${input.validationMessage}`);
    asked[name] = input.valueAsNumber;
  }
  if (byId("preset").value !== "robust") asked.config = { preset: byId("preset").value };
  asked.prior = prior();
  const box = region().map((input) => input.valueAsNumber / 100);
  const given = box.filter((number) => !Number.isNaN(number)).length;
  if (given && given < 6) throw new Error(`The region of interest has ${given} of its 6 numbers: give all, or none.`);
  if (given) asked.roi = box.map(exact);
  return asked;
}

function prior() {
  const kind = priorKind();
  if (kind !== "gaussian") return { kind: "uniform", orientation: kind };
  const text = byId("prior-text").value.trim();
  if (!text) throw new Error("The Gaussian prior is empty: paste prior.json, or choose it as a file.");
  try {
    return JSON.parse(text);
  } catch (error) {
    throw new Error(`The Gaussian prior is not JSON: ${error.message}.`);
  }
}

async function create(event) {
  event.preventDefault();
  const button = event.submitter ?? byId("create").querySelector("[type=submit]");
  await defaults; // files that come at once may be taken in before them
  await openNew("sessions", members, button, byId("create-trouble"), SETUP);
}
