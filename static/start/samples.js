// Which sample scenes are there? One click opens a session on one, and goes to its page.

import { call } from "../session/api.js";
import { byId, h, setText } from "../session/dom.js";
import { openNew } from "./stored.js";

export async function offerSamples() {
  const asked = call("/api/v1/samples").catch(() => []);
  // The button is there before the list, and may be clicked before it.
  byId("first-sample").addEventListener("click", async ({ currentTarget: button }) => {
    button.disabled = true;
    const [first] = await asked;
    if (first) await open(button, first.scene);
  });
  const scenes = await asked;
  byId("samples").hidden = !scenes.length;
  byId("first-sample").parentElement.hidden = !scenes.length;
  if (!scenes.length) return;
  const select = byId("sample");
  select.replaceChildren(...scenes.map((scene) => h("option", { value: scene.scene }, title(scene))));
  const about = () => setText(byId("sample-about"), scenes.find((scene) => scene.scene === select.value)?.about ?? "");
  select.addEventListener("change", about);
  about();
  byId("open-sample").addEventListener("click", (event) => open(event.currentTarget, select.value));
}

// Without the word that tells its session from others in the list.
function title(scene) {
  const text = scene.name.replace(/^Sample: /, "");
  return text[0].toUpperCase() + text.slice(1);
}

async function open(button, scene) {
  const text = button.textContent;
  setText(button, "Opening…");
  await openNew("sessions/sample", () => ({ scene, run: false }), button, byId("sample-trouble"), "?play=run");
  setText(button, text);
}
