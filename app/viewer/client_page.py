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
  let told = false;
  context.drawArrays = function (mode, ...range) {
    draw.call(this, mode, ...range);
    if (told || mode !== this.POINTS) return;
    told = true;
    for (const heard of [window, window.frameElement]) heard?.dispatchEvent(new Event("drawn"));
  };
}
</script>"""

# With `?economy`, which the session's page says where there is no graphics card, the processor draws: edges are not
# smoothed, there is a pause between two frames, but for the first ones and for a moment after a hand has moved, and
# viser's frame a second for no reason comes every five. viser goes on drawing for 250 ms after each change; while the
# session iterates, which the page around says by `data-busy`, the pause outlasts that, and a change is two frames
# instead of four. While something moves, also as the page plays (`data-plays`), one in FEWER of the squares is drawn,
# the first ones, which are spread over all, and smaller; all of them once it has been still: such a frame takes twice
# as long.
_ECONOMY = """<script>
if (new URLSearchParams(location.search).has("economy")) {
  const PAUSE = 150, BUSY = 270, MOVING = 500, BEAT = 1000, RARE = 5000, FIRST = 5000, STILL = 1200; // milliseconds
  const FEWER = 6, SMALLER = 0.75;
  let beat = () => {}; // has a frame drawn
  const every = window.setInterval.bind(window);
  window.setInterval = (act, delay, ...given) => {
    if (delay === BEAT) beat = act;
    return every(act, delay === BEAT ? RARE : delay, ...given);
  };
  const getContext = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, options) {
    return getContext.call(this, kind, kind.startsWith("webgl") ? { ...options, antialias: false } : options);
  };
  let last = -Infinity, moved = performance.now() + FIRST, count = 0;
  let moves = true, still;
  const move = () => {
    moves = true;
    clearTimeout(still);
    still = setTimeout(() => { moves = false; beat(); }, STILL);
  };
  addEventListener("drawn", () => { moved = -Infinity; move(); }, { once: true });
  for (const hand of ["pointerdown", "pointermove", "wheel", "keydown"]) {
    addEventListener(hand, (event) => {
      if (!event.buttons && event.pointerType) return;
      moved = performance.now();
      move();
    }, true);
  }
  const around = window.frameElement;
  const busy = () => around?.dataset.busy !== undefined;
  const changes = () => moves || busy() || around?.dataset.plays !== undefined;
  if (around) new MutationObserver(move).observe(around, { attributeFilter: ["data-busy", "data-plays"] });
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
    const pause = performance.now() - moved < MOVING ? 0 : last + (busy() ? BUSY : PAUSE) - performance.now();
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

  // By how far a point's corners reach viser's shader is told its shape, a square's farthest.
  const context = WebGL2RenderingContext.prototype;
  const { drawArrays, getUniformLocation, uniform1f, useProgram } = context;
  const drawing = new WeakMap(); // by program, of points: where it is told that and how much smaller; whether squares
  let now; // of the program in use
  context.getUniformLocation = function (program, name) {
    const place = getUniformLocation.call(this, program, name);
    if (name === "point_ball_norm") {
      drawing.set(program, { reach: place, smaller: getUniformLocation.call(this, program, "smaller"), square: false });
    }
    return place;
  };
  context.useProgram = function (program) {
    useProgram.call(this, program);
    now = program ? drawing.get(program) : undefined;
  };
  context.uniform1f = function (place, value) {
    uniform1f.call(this, place, value);
    if (place === now?.reach) now.square = value >= 1000;
  };
  context.drawArrays = function (mode, first, points) {
    if (!now?.square || !changes()) return drawArrays.call(this, mode, first, points);
    uniform1f.call(this, now.smaller, 1 - SMALLER);
    drawArrays.call(this, mode, first, Math.ceil(points / FEWER));
    uniform1f.call(this, now.smaller, 0);
  };
}
</script>"""


def scene_only(page: str, script: str = "") -> str:
    """A page of viser's, HTML, of which only the scene is seen. script : elements to be read first"""
    start = page.index("<head>") + len("<head>")
    return page[:start] + _STYLE + _RECONNECT + SHADERS + _SAYS_DRAWN + _ECONOMY + script + page[start:]
