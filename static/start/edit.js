// A name, and tags where there are some, in fields where they stand: Enter saves, Escape leaves them as they are.

import { byId, copyOf } from "../session/dom.js";
import { trouble } from "./confirm.js";

export const isEdited = (item) => Boolean(item?.querySelector(".edit"));

// In `item`, behind its element `after`. `save` is given the members that are others, and may throw what it is told
// instead; focus goes back to `button`.
export function edit(item, after, button, { name: called, tags: words }, save) {
  if (isEdited(item)) return;
  const form = copyOf("edit");
  const [name, tags] = form.querySelectorAll("input");
  const before = words?.join(", ") ?? "";
  name.value = called;
  tags.value = before;
  tags.closest("label").hidden = !words;
  const leave = () => {
    form.remove();
    button.focus();
  };
  form.querySelector("[type=button]").addEventListener("click", leave);
  form.addEventListener("keydown", (event) => {
    if (event.key !== "Escape" || event.isComposing) return;
    event.stopPropagation();
    leave();
  });
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const changes = {};
    if (name.value.trim() !== called) changes.name = name.value;
    if (tags.value.trim() !== before) changes.tags = tagsIn(tags.value);
    try {
      if (Object.keys(changes).length) await save(changes);
    } catch (problem) {
      trouble(form.querySelector(".trouble"), problem.message);
      return;
    }
    leave();
  });
  after.after(form);
  name.select();
}

// What is written between commas; a tag that is known already may hold some itself.
export function tagsIn(text) {
  const known = [...byId("known-tags").children].map((option) => option.value).filter((tag) => tag.includes(","));
  const found = new Set();
  for (let rest = text; rest; ) {
    rest = rest.trimStart();
    const tag = known.find((one) => rest === one || rest.startsWith(`${one},`)) ?? rest.split(",", 1)[0];
    found.add(tag.trim());
    rest = rest.slice(tag.length + 1);
  }
  return [...found].filter(Boolean);
}
