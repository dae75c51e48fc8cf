"""How does viser's page become ours? It keeps the scene, on our ground, and loses its panel and notices.

The session's page has the controls, and says itself when a connection is lost.
"""

from __future__ import annotations

from pathlib import Path

import viser

from app.palette import DARK_PAPER, PAPER

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


def scene_only(page: str, script: str = "") -> str:
    """A page of viser's, HTML, of which only the scene is seen. script : elements to be read first"""
    start = page.index("<head>") + len("<head>")
    return page[:start] + _STYLE + script + page[start:]
