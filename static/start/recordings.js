// What else is kept: recordings to look at, and the models and scans that sessions are made from.

import { call } from "../session/api.js";
import { byId, reconcile, setText } from "../session/dom.js";
import { confirmed, trouble } from "./confirm.js";
import { edit } from "./edit.js";
import { aboutModel, aboutRecording, aboutScan, bytes, count, when } from "./format.js";
import { onChange, refresh, remove, stored } from "./stored.js";

const LISTS = {
  recordings: { noun: "recording", about: aboutRecording, link: (entry) => `/sessions/${entry.id}/` },
  models: { noun: "model", about: aboutModel },
  scans: { noun: "scan", about: aboutScan },
};

export function showEntries() {
  onChange(() => {
    for (const kind of Object.keys(LISTS)) show(kind);
    const { models, scans } = stored;
    byId("material").hidden = !models.length && !scans.length;
    setText(byId("material-about"), `${count(models.length, "model")}, ${count(scans.length, "scan")}`);
  });
}

function show(kind) {
  const section = byId(kind);
  const place = section.querySelector("ul");
  const entries = stored[kind];
  section.hidden = !entries.length;
  // the same rows, in which somebody may be writing
  reconcile(
    place,
    "entry",
    entries,
    (entry) => entry.id,
    (item, entry) => fill(item, kind, entry),
  );
}

const title = (kind, entry) => (kind === "recordings" && entry.name) || entry.file_name;

function fill(item, kind, entry) {
  const { noun, about, link } = LISTS[kind];
  const part = (name) => item.querySelector(`.${name}`);
  const name = title(kind, entry);
  setText(part("entry-name"), name);
  if (link) part("entry-name").href = link(entry);
  setText(part("about"), `${about(entry)} · ${when(entry.created)}`);
  setText(part("size"), bytes(entry.bytes));
  part("delete").setAttribute("aria-label", `Delete the ${noun} ${name}`);
  part("delete").title = `Delete the ${noun}`;
  part("delete").onclick = () => forget(kind, noun, entry);
  part("rename").hidden = kind !== "recordings";
  part("rename").setAttribute("aria-label", `Name of the recording ${name}`);
  part("rename").onclick = () =>
    edit(item, part("what"), part("rename"), { name }, async (changes) => {
      await call(`/api/v1/recordings/${entry.id}`, { method: "PATCH", body: changes });
      await refresh(["recordings"]);
    });
}

async function forget(kind, noun, entry) {
  const text = `“${title(kind, entry)}”, ${bytes(entry.bytes)}, is removed from the server for good.`;
  if (!(await confirmed(`Delete this ${noun}?`, text))) return;
  const place = byId("trouble");
  try {
    await remove(kind, entry.id);
    trouble(place, "");
  } catch (problem) {
    trouble(place, problem.message); // as that a session uses it
    place.scrollIntoView({ block: "nearest" });
  }
}
