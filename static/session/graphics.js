// Does this browser draw without a graphics card? Then each picture takes the processor, which the inference may need.

// What the renderers are called that draw on the processor.
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

export function withoutGraphicsCard() {
  const pen = document.createElement("canvas").getContext("webgl");
  const names = pen?.getExtension("WEBGL_debug_renderer_info");
  const name = names ? pen.getParameter(names.UNMASKED_RENDERER_WEBGL) : "";
  pen?.getExtension("WEBGL_lose_context")?.loseContext();
  return SOFTWARE.test(name);
}
