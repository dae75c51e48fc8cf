// What can be done with several sessions at once: laid side by side, tagged, deleted.

import { call, sessionPath } from "../session/api.js";
import { byId, setAttributes, setText } from "../session/dom.js";
import { plural } from "../session/format.js";
import { title } from "./card.js";
import { confirmed, trouble } from "./confirm.js";
import { tagsIn } from "./edit.js";

const SIDE_BY_SIDE = [2, 4]; // sessions, as many as find place beside each other

const selected = new Set();
let [known, shown] = [[], []];
let follow;

export function install(changed) {
  follow = changed;
  byId("sessions").addEventListener("change", ({ target }) => {
    if (!target.closest(".choose")) return;
    selected[target.checked ? "add" : "delete"](target.value);
    show();
  });
  byId("select-all").addEventListener("click", () => {
    for (const session of shown) selected.add(session.id);
    show();
  });
  byId("select-none").addEventListener("click", () => {
    selected.clear();
    show();
    byId("sessions").querySelector("input")?.focus();
  });
  byId("tag-selected").addEventListener("submit", tag);
  byId("delete-selected").addEventListener("click", () => forget(chosen()));
}

const chosen = () => known.filter((session) => selected.has(session.id));

export function showSelection(sessions, listed) {
  [known, shown] = [sessions, listed];
  const there = new Set(sessions.map((session) => session.id));
  for (const id of selected) if (!there.has(id)) selected.delete(id);
  show();
}

function show() {
  for (const box of byId("sessions").querySelectorAll(".choose input")) box.checked = selected.has(box.value);
  byId("sessions").toggleAttribute("data-selecting", selected.size > 0);
  byId("selection").hidden = !selected.size;
  const hidden = selected.size - shown.filter((session) => selected.has(session.id)).length;
  setText(byId("selected"), `${selected.size} selected${hidden ? `, ${hidden} of them not in this list` : ""}`);
  byId("select-all").hidden = shown.every((session) => selected.has(session.id));
  setText(byId("select-all"), `All ${shown.length}`);
  const [least, most] = SIDE_BY_SIDE;
  const fits = selected.size >= least && selected.size <= most;
  const ids = chosen().map((session) => session.id);
  setAttributes(byId("side-by-side"), {
    href: fits ? `/compare?sessions=${ids}` : null,
    "aria-disabled": fits ? null : "true",
    role: fits ? null : "link",
    title: fits ? null : `Select ${least} to ${most} sessions`,
  });
}

async function tag(event) {
  event.preventDefault();
  const added = tagsIn(byId("tag-text").value);
  if (!added.length) return;
  const change = ({ id, tags }) =>
    call(sessionPath(id), { method: "PATCH", body: { tags: [...new Set([...tags, ...added])] } });
  if (await eachOf(chosen(), change)) byId("tag-text").value = "";
  follow();
}

// Ask, then delete.
export async function forget(sessions) {
  const [first] = sessions;
  if (!first) return;
  const [question, text] =
    sessions.length === 1
      ? ["Delete this session?", `“${title(first)}” stops after its present iteration. Its recording is removed`]
      : [
          `Delete ${sessions.length} sessions?`,
          `${some(sessions)} stop after their present iteration. Their recordings are removed`,
        ];
  if (!(await confirmed(question, `${text} from the server for good.`))) return;
  await eachOf(sessions, ({ id }) => call(sessionPath(id), { method: "DELETE" }));
  follow();
}

function some(sessions) {
  const names = sessions.slice(0, 3).map((session) => `“${title(session)}”`);
  const others = sessions.length - names.length;
  return others
    ? `${names.join(", ")} and ${plural(others, "other")}`
    : `${names.slice(0, -1).join(", ")} and ${names.at(-1)}`;
}

// Whether all of them went well; the first that did not is told of.
async function eachOf(sessions, act) {
  try {
    for (const session of sessions) await act(session);
  } catch (problem) {
    trouble(byId("trouble"), problem.message);
    return false;
  }
  return true;
}
