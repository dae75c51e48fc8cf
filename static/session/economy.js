// Without a graphics card the 3D view shows fewer of the scan's points while something moves and, while the session
// runs, a picture every two seconds. `?economy=0` in the page's address has it draw all, and `?economy=1` little. Where
// so many look that the server draws this view less often, that is said below the scene.

import { byId, setText } from "./dom.js";
import { state, subscribe } from "./state.js";
import { changeView } from "./view.js";

export function install() {
  const box = byId("economy");
  box.addEventListener("change", () => changeView({ economy: box.checked }));
  subscribe(["view"], () => {
    box.checked = state.view.economy;
    byId("slowed").hidden = !state.view.slowed;
    setText(byId("slowed"), state.view.slowed ?? "");
  });
  subscribe(["session", "playback"], () => {
    byId("scene").toggleAttribute("data-busy", state.session?.state === "running");
    byId("scene").toggleAttribute("data-plays", state.playback);
  });
}
