// The 3D views: one of each session, which the server draws; where one is turned, the others follow.

import { call, listen, sessionPath } from "../session/api.js";
import { setText } from "../session/dom.js";

const opened = [];

// Give a session's frame a view of its own that begins as `first` says; `together`: whether the others follow it.
export async function openView(column, first, together) {
  const id = crypto.getRandomValues(new Uint32Array(2)).reduce((text, value) => text + value.toString(16), "compare-");
  const view = { path: `${sessionPath(column.id)}/views/${id}`, camera: "null" };
  try {
    await call(view.path, { method: "PATCH", body: first });
  } catch (problem) {
    setText(column.trouble, problem.message); // as of a view too many
    return;
  }
  opened.push(view);
  column.frame.src = `/sessions/${encodeURIComponent(column.id)}/view/${id}/${first.economy ? "?economy" : ""}`;
  listen(`${view.path}/events`, { view: (state) => follow(view, state.camera, together) }, {});
}

// Say to all views the same.
export function changeAll(members) {
  for (const view of opened) change(view, members);
}

function change(view, members) {
  // where it is gone with its session, that is said in its column
  call(view.path, { method: "PATCH", body: members }).catch(() => {});
}

function follow(view, camera, together) {
  const turned = JSON.stringify(camera);
  if (view.camera === turned) return; // what it was told, or something else has changed
  view.camera = turned;
  if (camera === null || !together()) return;
  for (const other of opened) {
    if (other.camera === turned) continue;
    other.camera = turned;
    change(other, { camera });
  }
}
