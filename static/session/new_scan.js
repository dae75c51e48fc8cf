// How does the session go on with another scan? One of those on the server, or from a file, as another view of the same
// scene or as what the scene looks like now; it counts from the next iteration on.

import { add, addFiles } from "./add_files.js";
import { call } from "./api.js";
import { byId, h, sentence } from "./dom.js";
import { isRecording, state, subscribe } from "./state.js";

const wrong = sentence("new-scan-error");
let shown = "";

export function install() {
  byId("new-scan").addEventListener("submit", (event) => {
    event.preventDefault();
    send(() => add(byId("new-scan-id").value, mode()));
  });
  byId("new-scan-files").addEventListener("change", ({ target }) => send(() => addFiles(target, mode())));
  subscribe(["tab", "session"], show);
}

// The scans in force are not offered again.
async function show() {
  byId("new-scan").hidden = isRecording();
  const inForce = state.session?.scan_ids ?? [];
  if (state.tab !== "settings" || isRecording()) {
    shown = ""; // asked for again when somebody comes back: others may have been uploaded
    return;
  }
  if (shown === String(inForce)) return;
  shown = String(inForce);
  try {
    const scans = (await call("/api/v1/scans")).filter((scan) => !inForce.includes(scan.id)).reverse();
    const options = scans.map((scan) =>
      h("option", { value: scan.id }, `${scan.file_name} · ${new Date(scan.created).toLocaleString("en-GB")}`),
    );
    byId("new-scan-id").replaceChildren(
      ...(options.length ? options : [h("option", { value: "" }, "none: choose a file")]),
    );
    byId("new-scan-add").disabled = !options.length;
  } catch (problem) {
    wrong(problem.message);
  }
}

const mode = () => byId("new-scan").elements.mode.value;

async function send(adding) {
  try {
    await adding();
    wrong("");
  } catch (problem) {
    wrong(problem.message);
  }
}
