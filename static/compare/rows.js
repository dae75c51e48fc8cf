// What is told of every session, a row each; where the sessions differ, that is marked.

import { h, setContent } from "../session/dom.js";
import { fineCentimetres, joint, jointEnds, largest, methodWord, percent } from "../session/format.js";
import { verdictOf, verdictWord } from "../start/query.js";

// The table's bodies: a title, and rows of a name and what stands in each session's column.
function chapters(columns) {
  const names = (kind) => [...new Set(columns.flatMap(({ estimate }) => Object.keys(estimate?.[kind] ?? {})))];
  const row = (name, tell) => [name, columns.map(tell)];
  return [
    [
      "Found",
      [
        row("verdict", ({ session }) => verdictWord(session)),
        row("explained", ({ estimate }) => percent(estimate?.explained)),
        row("iteration", ({ session }) => String(session.iteration ?? "–")),
      ],
    ],
    ["Joints", names("joints").map((name) => row(name, ({ estimate }) => jointTold(estimate?.joints[name])))],
    ["Links: widest std", names("links").map((name) => row(name, ({ estimate }) => linkTold(estimate?.links[name])))],
    [
      "Made with",
      [
        row("method", ({ session }) => methodWord(session.method)),
        row("particles", ({ session }) => String(session.particles ?? "–")),
        row("seed", ({ session }) => String(session.seed ?? "–")),
        row("scans", ({ session }) => (session.kind === "recording" ? "–" : String(session.scan_ids.length))),
        row("settings", ({ session }) => (session.kind === "recording" ? "–" : settingsTold(session.config))),
        row("tags", ({ session }) => session.tags.join(", ") || "–"),
      ],
    ],
  ].filter(([, rows]) => rows.length);
}

function jointTold(found) {
  if (!found) return "–";
  const position = joint(found.type, found.position);
  if (!found.interval || Array.isArray(found.position)) return position;
  return `${position} (${jointEnds(found.type, found.interval)})`;
}

function linkTold(found) {
  if (!found) return "–";
  const std = largest(found.std_xyz);
  return std === null ? "not read out" : `${fineCentimetres(std)}, ${found.certain ? "certain" : "not certain"}`;
}

const settingsTold = (config) =>
  Object.entries(config)
    .map(([name, value]) => `${name} ${value}`)
    .join(", ") || "robust";

export function showRows(table, columns) {
  const told = chapters(columns);
  while (table.tBodies.length > told.length) table.tBodies[table.tBodies.length - 1].remove();
  while (table.tBodies.length < told.length) table.append(h("tbody"));
  // the same rows while nothing is new, so that what somebody reads or marks stays
  told.forEach(([title, rows], at) => {
    const heading = h("th", { scope: "rowgroup", colspan: columns.length + 1 }, title);
    const others = rows.map(([name, texts]) => line(name, texts, columns));
    setContent(table.tBodies[at], h("tr", { class: "chapter" }, heading), ...others);
  });
}

function line(name, texts, columns) {
  const verdict = (at) => (name === "verdict" ? verdictOf(columns[at].session) : null);
  const cells = texts.map((text, at) => h("td", { "data-verdict": verdict(at) }, text));
  const differs = texts.some((text) => text !== texts[0]) && h("span", { class: "mark", title: "they differ" }, " ≠");
  return h("tr", {}, h("th", { scope: "row", title: name }, name, differs || null), cells);
}
