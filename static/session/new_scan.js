// How does the session go on with another scan? One of those on the server, as another view of the same scene or as what
// the scene looks like now; it counts from the next iteration on.

import { call, sessionPath } from "./api.js";
import { byId, h, sentence } from "./dom.js";
import { isRecording, state, subscribe, update } from "./state.js";

const wrong = sentence("new-scan-error");
let shown = "";

export function install() {
  byId("new-scan").addEventListener("submit", (event) => {
    event.preventDefault();
    send();
  });
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
      ...(options.length ? options : [h("option", { value: "" }, "none: upload one on the start page")]),
    );
    byId("new-scan-add").disabled = !options.length;
  } catch (problem) {
    wrong(problem.message);
  }
}

async function send() {
  const body = { scan_id: byId("new-scan-id").value, mode: byId("new-scan").elements.mode.value };
  try {
    const session = await call(`${sessionPath(state.id)}/scans`, { method: "POST", body });
    wrong("");
    update({ session: { ...state.session, scan_ids: session.scan_ids } });
  } catch (problem) {
    wrong(problem.message);
  }
}
