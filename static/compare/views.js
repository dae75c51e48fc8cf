// The 3D views: one of each session, which the server draws; where a hand turns one, the others follow.

import { call, listen, sessionPath } from "../session/api.js";
import { setText } from "../session/dom.js";
import { listed, minus, plus, turned } from "../session/vectors.js";
import { randomId } from "../session/view_id.js";

const opened = [];
let held = null; // the view that a hand was at last

// Give a session's frame a view of its own that begins as `first` says; `together`: whether the others follow it.
export async function openView(column, first, together) {
  const id = `compare-${randomId()}`;
  const view = { path: `${sessionPath(column.id)}/views/${id}`, column };
  try {
    await call(view.path, { method: "PATCH", body: first });
  } catch (problem) {
    setText(column.trouble, problem.message); // as of a view too many
    return;
  }
  opened.push(view);
  column.frame.addEventListener("load", () => noticeHands(view));
  column.frame.src = `/sessions/${encodeURIComponent(column.id)}/view/${id}/${first.economy ? "?economy" : ""}`;
  // what comes without a hand is the browser that arranges itself, or what another view has said
  const follow = ({ camera }) => camera && view === held && together() && lead(view, camera);
  listen(`${view.path}/events`, { view: follow }, {});
}

function noticeHands(view) {
  for (const kind of ["pointerdown", "wheel", "keydown"]) {
    const notice = () => {
      held = view;
    };
    view.column.frame.contentWindow.addEventListener(kind, notice, { capture: true, passive: true });
  }
}

// Say to all views the same.
export function changeAll(members) {
  for (const view of opened) change(view, members);
}

function change(view, members) {
  // where it is gone with its session, that is said in its column
  call(view.path, { method: "PATCH", body: members }).catch(() => {});
}

function lead(view, camera) {
  for (const other of opened) {
    if (other !== view) change(other, { camera: carried(camera, view.column, other.column) });
  }
}

// The same place to look from: in world where both look at one scan, else beside the object, by its first link.
function carried({ position, look_at, up }, from, to) {
  const shared = from.session.scan_ids.some((id) => to.session.scan_ids.includes(id));
  const [here, there] = [from, to].map(({ estimate }) => Object.values(estimate?.links ?? {})[0]?.pose);
  if (shared || !here || !there) return { position, look_at, up };
  const { x, y, z, w } = here.orientation;
  const direction = (vector) => turned(turned(vector, { x: -x, y: -y, z: -z, w }), there.orientation);
  const place = (point) => plus(direction(minus(point, listed(here.position))), listed(there.position));
  return { position: place(position), look_at: place(look_at), up: direction(up) };
}
