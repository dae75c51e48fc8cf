// Which sample scenes are there? One click opens a session on one, and goes to its page.

import { call } from "../session/api.js";
import { byId, h, setText } from "../session/dom.js";
import { openNew } from "./stored.js";

export async function offerSamples() {
  const scenes = await call("/api/v1/samples").catch(() => []);
  const select = byId("sample");
  byId("samples").hidden = !scenes.length;
  byId("first-sample").parentElement.hidden = !scenes.length;
  if (!scenes.length) return;
  select.replaceChildren(...scenes.map((scene) => h("option", { value: scene.scene }, title(scene))));
  const about = () => setText(byId("sample-about"), scenes.find((scene) => scene.scene === select.value)?.about ?? "");
  select.addEventListener("change", about);
  about();
  byId("open-sample").addEventListener("click", (event) => open(event.currentTarget, select.value));
  byId("first-sample").addEventListener("click", (event) => open(event.currentTarget, scenes[0].scene));
}

// Without the word that tells its session from others in the list.
function title(scene) {
  const text = scene.name.replace(/^Sample: /, "");
  return text[0].toUpperCase() + text.slice(1);
}

async function open(button, scene) {
  const text = button.textContent;
  setText(button, "Opening…");
  await openNew("sessions/sample", () => ({ scene }), button, byId("sample-trouble"));
  setText(button, text);
}
