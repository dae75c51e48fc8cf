// What is shown in this tab's 3D view? Its state lives in the server, so that a program can change it too; here it is
// changed at once, sent one change after the other, and followed by events.

import { call, listen, root } from "./api.js";
import { DEFAULT_VIEW, put, state, theme, touch } from "./state.js";

// What is told to a server that has forgotten the view, as after its restart.
const MEMBERS = [...Object.keys(DEFAULT_VIEW), "theme", "hidden"];

let queued = {};
let sent = null; // on its way
let known = true; // whether the server keeps views' states
let end = null;

const path = () => `${root(state.id)}/views/${state.viewId}`;

export async function openView(first) {
  try {
    take(await call(path()));
  } catch {
    known = false;
  }
  change({ ...first, theme: theme(), hidden: document.hidden });
  if (!known) return;
  end?.();
  let before = false;
  end = listen(`${path()}/events`, { view: take }, {
    opened: () => {
      if (before) change(Object.fromEntries(MEMBERS.map((name) => [name, state.view[name]]))); // it may have forgotten
      before = true;
    },
  });
}

// Show something else. `show` may name some members only.
export function change(members) {
  const whole = members.show ? { ...members, show: { ...state.view.show, ...members.show } } : members;
  Object.assign(state.view, whole);
  touch("view");
  Object.assign(queued, whole);
  send();
}

// Look at another iteration, null for the newest; a particle has no counterpart there.
export const goTo = (iteration) => change({ iteration, particle: null });

async function send() {
  if (sent || !known || !Object.keys(queued).length) return;
  sent = queued;
  queued = {};
  try {
    const answer = await call(path(), { method: "PATCH", body: sent });
    sent = null;
    take(answer);
  } catch (error) {
    if (error.status === 404 || error.status === 405) known = error.status === 404;
    if (error.status === 422) put({ trouble: error.message });
  } finally {
    sent = null;
    send();
  }
}

// What the server says holds, but for what it has not been told yet.
function take(view) {
  const told = { ...view };
  for (const name of Object.keys({ ...sent, ...queued })) delete told[name];
  if (told.show) told.show = { ...DEFAULT_VIEW.show, ...told.show };
  Object.assign(state.view, told);
  touch("view");
}
