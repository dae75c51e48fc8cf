"""What came of a batch, to be looked through? One page of HTML, the worst first, with a picture of each estimate.

Pictures and results lie in folders beside it, so that a thousand of them can be opened; the page itself fetches nothing
else, has no scripts, and takes no markup from names.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from urllib.parse import quote

from pmpnbp.batch.report_style import STYLE
from pmpnbp.batch.told import CERTAIN, DOUBTFUL, ERROR, FOUND, NO_VERDICT, NOT_FOUND, VERDICTS, WAITING, Told

# Joints that are seen at once; further ones are folded in.
SEEN = 6
HEADINGS = {
    ERROR: "No result, for an error",
    NOT_FOUND: "Not found",
    NO_VERDICT: "No verdict: the search had not ended",
    DOUBTFUL: "Doubtful",
    FOUND: "Found, not all of it certain",
    CERTAIN: "Found, every link certain",
    WAITING: "Not made yet",
}


def report(rows: Sequence[Told], title: str) -> str:
    """HTML, whose links are relative to the folder that it stands in."""
    parts = {verdict: [row for row in rows if row.verdict == verdict] for verdict in VERDICTS}
    counts = "".join(
        f'<li class="{_id(verdict)}"><a href="#{_id(verdict)}"><b>{len(some)}</b> {escape(verdict)}</a></li>\n'
        for verdict, some in parts.items()
        if some
    )
    sections = "".join(_section(verdict, some) for verdict, some in parts.items() if some)
    seconds = sum(row.seconds or 0.0 for row in rows)
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<style>{STYLE}</style>
</head>
<body>
<main>
<h1>{escape(title)}</h1>
<p class="quiet">{_rows(len(rows))}, the worst first; {_time(seconds)} of inference.
<a href="table.csv">The same as a table (CSV)</a></p>
<nav aria-label="Verdicts"><ul class="counts">
{counts}</ul></nav>
{sections}</main>
</body>
</html>
"""


def _section(verdict: str, rows: Sequence[Told]) -> str:
    cards = "".join(_card(row) for row in rows)
    return f"""<section class="{_id(verdict)}" id="{_id(verdict)}">
<h2>{escape(HEADINGS[verdict])} ({len(rows)})</h2>
<ul class="rows">
{cards}</ul>
</section>
"""


def _card(row: Told) -> str:
    picture = ""
    if row.picture is not None:
        alt = f"The estimate of {row.name} over its scan"
        # its size is the scan's, so that the page keeps no room for it before it is there; most are 4 by 3
        picture = (
            f'<img src="{_link(row.picture)}" alt="{escape(alt)}" loading="lazy" style="aspect-ratio: auto 4 / 3">\n'
        )
    told = [] if row.model is None else [escape(row.model)]
    if row.seconds is not None:
        told.append(f"{row.iterations} iterations, {row.seconds:.1f}\u00a0s")
    if row.result is not None:
        told.append(f'<a href="{_link(row.result)}">result (JSON)</a>')
    return f"""<li>
{picture}<div class="about">
<h3>{escape(row.name)}</h3>
<p>{escape(row.sentence)}</p>
{_joints(row)}<p class="quiet">{" · ".join(told)}</p>
</div>
</li>
"""


def _joints(row: Told) -> str:
    if not row.standings:
        return ""
    lines = [f"<dt>{escape(name.removeprefix('joint '))}</dt><dd>{escape(place)}</dd>" for name, place in row.standings]
    seen, more = lines[:SEEN], lines[SEEN:]
    folded = f"<details><summary>{len(more)} more</summary><dl>{''.join(more)}</dl></details>\n" if more else ""
    return f"<dl>{''.join(seen)}</dl>\n{folded}"


def _link(path: str) -> str:
    return escape(quote(path))


def _id(verdict: str) -> str:
    return verdict.replace(" ", "-")


def _rows(count: int) -> str:
    return "1 estimate" if count == 1 else f"{count} estimates"


def _time(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"
