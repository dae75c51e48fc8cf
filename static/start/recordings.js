// What else is kept: recordings to look at, and the models and scans that sessions are made from.

import { byId, copyOf, setText } from "../session/dom.js";
import { confirmed, trouble } from "./confirm.js";
import { aboutModel, aboutRecording, aboutScan, bytes, count, when } from "./format.js";
import { onChange, remove, stored } from "./stored.js";

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
  place.replaceChildren(...entries.map((entry) => row(kind, entry)));
}

function row(kind, entry) {
  const { noun, about, link } = LISTS[kind];
  const item = copyOf("entry");
  const name = item.querySelector(".entry-name");
  setText(name, entry.file_name);
  if (link) name.href = link(entry);
  setText(item.querySelector(".about"), `${about(entry)} · ${when(entry.created)}`);
  setText(item.querySelector(".size"), bytes(entry.bytes));
  const button = item.querySelector(".delete");
  button.setAttribute("aria-label", `Delete the ${noun} ${entry.file_name}`);
  button.title = `Delete the ${noun}`;
  button.addEventListener("click", () => forget(kind, noun, entry));
  return item;
}

async function forget(kind, noun, entry) {
  const text = `“${entry.file_name}”, ${bytes(entry.bytes)}, is removed from the server for good.`;
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
