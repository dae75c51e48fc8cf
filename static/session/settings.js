// With which settings does the inference go on? Every entry of /api/v1/settings with its help, unit and limits, lengths
// in centimetres and angles in degrees as all over the page; a change counts from the next iteration on. Method and
// particle count are a session's for life: those start a new one.

import { call, sessionPath } from "./api.js";
import { startDerivedSession } from "./derived_session.js";
import { button, byId, h, setText } from "./dom.js";
import { exact, methodWord, unitRead } from "./format.js";
import { isGone, isRecording, state, subscribe, update } from "./state.js";

// Where a stage's settings begin, by the first one's name; the server lists them in the order of the stages.
const STAGES = {
  image_width: "Scan and rendering",
  pixel_score: "Unary potential",
  pairwise_form: "Pairwise potential",
  joint_draws: "Messages and beliefs",
  anneal_iterations: "Annealing",
  search_iterations: "Search",
  refine_iterations: "Refinement and rest",
};

const rows = new Map();
let entries = [];
let filled = {};
let told = Promise.resolve(); // of the change before, once it is answered

export async function install() {
  for (const preset of ["robust", "paper"]) byId(`preset-${preset}`).addEventListener("click", () => send({ preset }));
  byId("anew").addEventListener("input", () => setText(byId("anew-error"), ""));
  byId("anew").addEventListener("submit", (event) => {
    event.preventDefault();
    const [method, particles] = [byId("method").value, Number(byId("particle-count").value)];
    const what = [method === "pmpnbp" ? null : methodWord(method), `${particles} particles`].filter(Boolean).join(", ");
    startDerivedSession({ method, particles }, what, (text) => setText(byId("anew-error"), text));
  });
  subscribe(["session"], show);
  const { settings, options } = await call("/api/v1/settings");
  entries = settings;
  const { low, high } = options.find((option) => option.name === "particles");
  for (const id of ["particle-count", "setup-particles"]) Object.assign(byId(id), { min: low, max: high });
  let group = null;
  for (const entry of entries) {
    if (STAGES[entry.name] || !group) {
      group = h("div", { class: "settings-rows" });
      byId("settings-groups").append(
        h("details", { open: entry === entries[0] || entry.name === "pixel_score" }, [
          h("summary", {}, STAGES[entry.name] ?? "Other"),
          group,
        ]),
      );
    }
    group.append(row(entry));
  }
  show();
}

function row(entry) {
  const id = `setting-${entry.name}`;
  const { word, factor } = unitRead(entry.unit);
  const number = (value) => exact(value * factor);
  const changed = () => {
    const value =
      entry.kind === "boolean"
        ? input.checked
        : entry.kind === "string"
          ? input.value
          : exact(Number(input.value) / factor);
    if (input.value === "" && entry.kind !== "boolean") {
      wrong("");
      input.value = number(inForce(entry)); // an empty field changes nothing
    } else send({ [entry.name]: value }, wrong);
  };
  const ends = [entry.low, entry.high].map((end) => (end === null ? null : number(end)));
  const step = entry.kind === "integer" ? "1" : "any";
  const input = entry.choices.length
    ? h("select", { id }, [entry.choices.map((choice) => h("option", { value: choice }, choice))])
    : entry.kind === "boolean"
      ? h("input", { id, type: "checkbox", role: "switch" })
      : h("input", { id, type: "number", step, min: ends[0], max: ends[1] });
  input.setAttribute("aria-describedby", `${id}-help`);
  input.addEventListener("change", changed);
  const error = h("p", { class: "wrong", role: "alert", hidden: true });
  const wrong = (text) => {
    setText(error, text);
    error.hidden = !text;
  };
  const standard = typeof entry.default === "number" ? `${number(entry.default)} ${word}`.trim() : entry.default;
  const reset = button("↺", () => send({ [entry.name]: entry.default }, wrong), {
    class: "reset",
    "aria-label": `Reset ${entry.name} to ${standard}`,
    title: `reset to ${standard}`,
  });
  const limits = [ends[0] !== null ? `from ${ends[0]}` : "", ends[1] !== null ? `to ${ends[1]}` : ""]
    .filter(Boolean)
    .join(" ");
  const place = h("div", { class: "setting" }, [
    h("label", { for: id }, entry.name.replaceAll("_", " ")),
    input,
    h("span", { class: "unit" }, word),
    reset,
    h("p", { class: "help", id: `${id}-help` }, [
      entry.help,
      limits ? h("span", { class: "limits" }, ` · ${limits}`) : null,
    ]),
    error,
  ]);
  rows.set(entry.name, { entry, input, number, reset, place });
  return place;
}

const ofPaper = () => state.session.config?.preset === "paper";
const inForce = (entry) => state.session.config?.[entry.name] ?? (ofPaper() ? entry.paper : entry.default);

function show() {
  const session = state.session;
  if (!session) return;
  const paper = ofPaper();
  byId("preset-robust").setAttribute("aria-pressed", String(!paper));
  byId("preset-paper").setAttribute("aria-pressed", String(paper));
  const fixed = isRecording() || isGone();
  byId("settings-fixed").hidden = !isRecording();
  for (const preset of ["robust", "paper"]) byId(`preset-${preset}`).disabled = fixed;
  for (const { entry, input, number, reset, place } of rows.values()) {
    const value = inForce(entry);
    if (document.activeElement !== input || input.type === "checkbox") {
      if (input.type === "checkbox") input.checked = Boolean(value);
      else input.value = typeof value === "number" ? number(value) : value;
    }
    input.disabled = fixed;
    const changed = value !== entry.default;
    place.dataset.changed = String(changed);
    reset.disabled = !changed || fixed;
  }
  fillAnew(session.method ?? "pmpnbp", session.particles ?? "");
  byId("anew-start").disabled = isRecording();
}

// What a reader has chosen for a new session stays, whatever else this one does meanwhile.
function fillAnew(method, particles) {
  if (filled.method === method && filled.particles === particles) return;
  filled = { method, particles };
  byId("method").value = method;
  byId("particle-count").value = particles;
}

// One change after the other: sent side by side they could come in another order than they were made in, and the answer to
// an earlier one would take away what is wrong with a later one.
function send(config, wrong = (trouble) => trouble && update({ trouble })) {
  told = told.then(async () => {
    try {
      const session = await call(sessionPath(state.id), { method: "PATCH", body: { config } });
      update({ session: { ...state.session, config: session.config } });
      wrong("");
    } catch (problem) {
      wrong(problem.message);
    }
  });
}
