// What is shown in this tab's 3D view? Its state lives in the server, so that a program can change it too; here it is
// changed at once, sent one change after the other, and followed by events.

import { call, listen, sessionPath } from "./api.js";
import { isGone, notify, state, subscribe, theme, update } from "./state.js";

let declared = {}; // the members of a view's state, as a JSON schema
let queued = {};
let sent = null; // on its way
let closeEvents = null;
let newest = {}; // answer or event that was applied
let refused = ""; // why a change was, as it is told

const path = () => `${sessionPath(state.id)}/views/${state.viewId}`;

// Learn which members a view has, and begin with their defaults.
export async function declareView() {
  declared = await call("/api/v1/view-state");
  const defaults = Object.entries(declared.properties).map(([name, member]) => [name, member.default]);
  state.view = structuredClone(Object.fromEntries(defaults));
}

// Every layer's declaration, by name: title, group, description.
export const layers = () => declared.$defs.Layers.properties;
// The values that a member can have.
export const choices = (name) => declared.properties[name].enum;
// What the colours mean that a member chooses: pairs of meaning and colour.
export const legend = (name) => declared.properties[name].legend;

// opened: the answer to a first change, which may have come to nothing
export async function openView(first, opened) {
  let before = false;
  try {
    applyAnswer(await opened.catch(() => call(path())));
  } catch (error) {
    // of a view too many; gone with the first event, once there is room for it
    if (error.status === 429) applyAnswer({ error: error.message });
    else update({ trouble: error.message });
    before = true;
  }
  changeView({ ...first, theme: theme(), hidden: document.hidden });
  closeEvents?.();
  closeEvents = listen(
    `${path()}/events`,
    { view: applyAnswer },
    {
      opened: (rested) => {
        const { revision } = newest;
        newest = {}; // a view that was forgotten counts anew
        if (before && rested) remind(revision);
        else if (before) sendAll(); // the server may have forgotten the view, as after its restart, or had no room for it
        before = true;
      },
    },
  );
  subscribe(["session"], () => isGone() && closeEvents());
}

function sendAll(view = state.view) {
  changeView(Object.fromEntries(Object.keys(declared.properties).map((name) => [name, view[name]])));
}

// While nobody saw the page a program may have changed the view: all is sent only where it was forgotten, and began anew.
async function remind(revision) {
  const view = { ...state.view, show: { ...state.view.show } };
  const known = await call(path()).catch(() => null);
  if (known && known.revision < revision) sendAll(view);
}

// Show something else. `show` may name some members only.
export function changeView(members) {
  const whole = members.show ? { ...members, show: { ...state.view.show, ...members.show } } : members;
  Object.assign(state.view, whole);
  notify("view");
  Object.assign(queued, whole);
  send();
}

// Look at another iteration, null for the newest; a particle has no counterpart there.
export const goToIteration = (iteration) => changeView({ iteration, particle: null });

async function send() {
  if (sent || isGone() || !Object.keys(queued).length) return;
  sent = queued;
  queued = {};
  try {
    const answer = await call(path(), { method: "PATCH", body: sent });
    sent = null;
    applyAnswer(answer);
    if (refused && state.trouble === refused) update({ trouble: "" });
    refused = "";
  } catch (error) {
    if (error.status === 422) {
      refused = error.message;
      update({ trouble: refused });
    }
  } finally {
    sent = null;
    send();
  }
}

// What the server says holds, but for what it has not been told yet.
function applyAnswer(view) {
  // where an event has overtaken the answer, it holds from now on in what was on its way, too
  if (!(view.revision < newest.revision)) newest = view;
  const known = { ...newest };
  for (const name of Object.keys({ ...sent, ...queued })) delete known[name];
  Object.assign(state.view, known);
  notify("view");
}
