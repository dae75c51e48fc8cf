"""What does an exported scene say besides its picture? Whose it is, what was found, where the joints stand, a legend.

Plain HTML within viser's page, nothing to be fetched, in the page's own light or dark; folded where it would cover too
much of the picture.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from app.viewer.legend import LegendEntry
from app.viewer.view_state import Theme
from pmpnbp.library.estimate import Estimate, standings

_STYLE = """<style>
.caption { --ink: light-dark(#1f2630, #e8ebef); --quiet: light-dark(#59626f, #9ba6b4);
  --line: light-dark(#dcdfe4, #2e3742);
  position: fixed; z-index: 10; top: 0.7rem; left: 0.7rem; box-sizing: border-box; width: max-content;
  max-width: min(23rem, calc(100% - 1.4rem)); max-height: calc(100% - 1.4rem); overflow: auto; padding: 0.5rem 0.8rem;
  border: 1px solid var(--line); border-radius: 8px; background: light-dark(#ffffffdd, #1a2027dd); color: var(--ink);
  font: 13px/1.45 system-ui, sans-serif; font-variant-numeric: tabular-nums; overflow-wrap: anywhere; }
.caption h1 { display: inline; margin: 0; font-size: 1rem; }
.caption p { margin: 0.25rem 0 0; }
.caption summary { cursor: pointer; }
.caption .quiet, .caption th { color: var(--quiet); font-weight: 400; }
.caption table { margin-top: 0.4rem; border-collapse: collapse; }
.caption th, .caption td { padding: 0.1rem 0.9rem 0.1rem 0; text-align: left; vertical-align: top; }
.caption ul { display: grid; gap: 0.15rem; margin: 0.5rem 0 0; padding: 0.45rem 0 0; border-top: 1px solid var(--line);
  list-style: none; }
.caption li { display: flex; gap: 0.5rem; align-items: center; }
.caption i { flex: none; width: 16px; height: 9px; border-radius: 2px; }
.caption i.line { height: 2px; }
.caption i.ellipsoid, .caption i.points { width: 10px; margin: 0 3px; border-radius: 50%; }
@media (max-width: 600px) { .caption { max-height: 60%; } }
</style>"""
_FOLDED_ON_A_PHONE = "<script>document.currentScript.previousElementSibling.open = innerWidth > 600;</script>"
# Of what has no one colour.
_QUIET = "#8b97a6"


def captioned(page: str, theme: Theme, name: str, result: Mapping[str, Any], legend: Sequence[LegendEntry]) -> str:
    """The page, HTML, with a title and a caption. name : of the session; result : as result.json"""
    estimate = Estimate.from_dict(result)
    title = escape(f"{name}, iteration {estimate.iteration}")
    rows = "".join(
        f"<tr><th scope=row>{escape(what)}</th><td>{escape(where)}</td></tr>" for what, where in standings(estimate)
    )
    lines = "".join(_line(entry) for entry in legend)
    ninety = ", in brackets the central 90&nbsp;%" if estimate.fit is not None else ""
    caption = (
        f'<details class=caption style="color-scheme:{theme}" open>'
        f"<summary><h1>{escape(name)}</h1></summary>"
        f'<p class="quiet">{escape(estimate.model)}, iteration {estimate.iteration}{ninety}</p>'
        f"<p>{escape(estimate.verdict)}.</p><table>{rows}</table><ul aria-label=Legend>{lines}</ul></details>"
        f"{_FOLDED_ON_A_PHONE}"
    )
    page = re.sub("<title>.*?</title>", lambda _: f"<title>{title}</title>", page, count=1, flags=re.DOTALL)
    end = page.rindex("</body>")
    return page[:end] + _STYLE + caption + page[end:]


def _line(entry: LegendEntry) -> str:
    near, far = (entry.colours[0], entry.colours[-1]) if entry.colours else (_QUIET, _QUIET)
    mark = f'<i class="{entry.sign}" style="background:linear-gradient(to right,{near},{far})"></i>'
    return f"<li>{mark}<span>{escape(entry.text)}</span></li>"
