// Does this browser draw without a graphics card? Then each picture takes the processor, which the inference may need
// too: the 3D view shows fewer of the scan's points and, while the session runs, a picture every two seconds.
// `?economy=0` in the page's address has it draw all, and `?economy=1` little. Where so many look that the server draws
// this view less often, that is said below the scene.

import { byId, setText } from "./dom.js";
import { state, subscribe } from "./state.js";
import { changeView } from "./view.js";

// What the renderers are called that draw on the processor.
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

export function withoutGraphicsCard() {
  const pen = document.createElement("canvas").getContext("webgl");
  const names = pen?.getExtension("WEBGL_debug_renderer_info");
  const name = names ? pen.getParameter(names.UNMASKED_RENDERER_WEBGL) : "";
  pen?.getExtension("WEBGL_lose_context")?.loseContext();
  return SOFTWARE.test(name);
}

export function install() {
  const box = byId("economy");
  box.addEventListener("change", () => changeView({ economy: box.checked }));
  subscribe(["view"], () => {
    box.checked = state.view.economy;
    byId("slowed").hidden = !state.view.slowed;
    setText(byId("slowed"), state.view.slowed ?? "");
  });
  subscribe(["session"], () => byId("scene").toggleAttribute("data-busy", state.session?.state === "running"));
}
