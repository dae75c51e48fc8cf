"""How does viser's page become ours? It keeps the scene, on our ground, and loses its panel and notices.

The session's page has the controls, and says itself when a connection is lost.
"""

from __future__ import annotations

from pathlib import Path

import viser

from app.viewer.client_shaders import SHADERS
from pmpnbp.pictures.palette import DARK_PAPER, PAPER

CLIENT_PAGE = Path(viser.__file__).parent / "client" / "build" / "index.html"

_STYLE = f"""<style>
:root {{ color-scheme: light dark; --ground: light-dark({PAPER}, {DARK_PAPER}); }}
:root[data-mantine-color-scheme="light"] {{ --ground: {PAPER}; }}
:root[data-mantine-color-scheme="dark"] {{ --ground: {DARK_PAPER}; }}
html, body {{ background: var(--ground) !important; }}
#root div:has(> div > [data-dock-root]) {{ background: transparent !important; }}
[data-floating-window], [data-dock-resize], .mantine-Notifications-root,
#root .mantine-Paper-root:has(.mantine-ScrollArea-root) {{ display: none !important; }}
</style>"""

# viser's page connects again after a break only while it has the focus, which in a frame it seldom has: the scene would
# stand still after a restart of the server, whatever the page around it shows.
_RECONNECT = "<script>document.hasFocus = () => true;</script>"

# It is told once, here and to the page around, that the picture has something: points, of the scan or the belief.
_SAYS_DRAWN = """<script>
{
  const context = WebGL2RenderingContext.prototype, draw = context.drawArrays;
  context.drawArrays = function (mode, ...range) {
    draw.call(this, mode, ...range);
    if (mode !== this.POINTS) return;
    context.drawArrays = draw;
    for (const heard of [window, window.frameElement]) heard?.dispatchEvent(new Event("drawn"));
  };
}
</script>"""

# With `?economy`, which the session's page says where there is no graphics card, the processor draws: edges are not
# smoothed, there is a pause between two frames, but for the first ones and for a moment after a hand has moved, and
# viser's frame a second for no reason comes every five. viser goes on drawing for 250 ms after each change; while the
# session iterates, which the page around says by `data-busy`, the pause outlasts that, and a change is two frames
# instead of four.
_ECONOMY = """<script>
if (new URLSearchParams(location.search).has("economy")) {
  const PAUSE = 150, BUSY = 270, MOVING = 500, BEAT = 1000, RARE = 5000, FIRST = 5000; // milliseconds
  const every = window.setInterval.bind(window);
  window.setInterval = (act, delay, ...given) => every(act, delay === BEAT ? RARE : delay, ...given);
  const context = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, options) {
    return context.call(this, kind, kind.startsWith("webgl") ? { ...options, antialias: false } : options);
  };
  let last = -Infinity, moved = performance.now() + FIRST, count = 0;
  addEventListener("drawn", () => { moved = -Infinity; }, { once: true });
  for (const hand of ["pointerdown", "pointermove", "wheel", "keydown"]) {
    addEventListener(hand, (event) => { if (event.buttons || !event.pointerType) moved = performance.now(); }, true);
  }
  const soon = window.requestAnimationFrame.bind(window), never = window.cancelAnimationFrame.bind(window);
  const waiting = new Map(); // by the number that was given out, what ends the wait
  window.requestAnimationFrame = (draw) => {
    const id = ++count;
    const ask = () => {
      const frame = soon((time) => {
        waiting.delete(id);
        last = performance.now();
        draw(time);
      });
      waiting.set(id, () => never(frame));
    };
    const wanted = window.frameElement?.dataset.busy === undefined ? PAUSE : BUSY;
    const pause = performance.now() - moved < MOVING ? 0 : last + wanted - performance.now();
    if (pause > 0) {
      const timer = setTimeout(ask, pause);
      waiting.set(id, () => clearTimeout(timer));
    } else ask();
    return id;
  };
  window.cancelAnimationFrame = (id) => {
    waiting.get(id)?.();
    waiting.delete(id);
  };
}
</script>"""


def scene_only(page: str, script: str = "") -> str:
    """A page of viser's, HTML, of which only the scene is seen. script : elements to be read first"""
    start = page.index("<head>") + len("<head>")
    return page[:start] + _STYLE + _RECONNECT + SHADERS + _SAYS_DRAWN + _ECONOMY + script + page[start:]
