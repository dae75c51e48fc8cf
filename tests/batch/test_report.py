"""Does the report show every row once, the worst first, and take no markup from names? Is no name a formula?"""

from __future__ import annotations

import csv
import io
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pmpnbp.batch.report import HEADINGS, report
from pmpnbp.batch.report_style import STYLE
from pmpnbp.batch.table import COLUMNS, table
from pmpnbp.batch.told import CERTAIN, ERROR, VERDICTS, WAITING, Told
from pmpnbp.library.estimated import JointEstimate
from pmpnbp.pictures.palette import contrast, rgb

WORDS = "html head meta title style body main h1 h2 h3 p a nav ul li b section img div dl dt dd details summary"
ELEMENTS = frozenset(WORDS.split())
TEXT = st.text(st.characters(codec="utf-8"), max_size=8) | st.sampled_from(
    ["<script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "</style>", "&lt;", "javascript:alert(1)", "=1+1"]
)


def joint(name: str, axes: int = 1, known: bool = True) -> JointEstimate:
    numbers = np.arange(axes, dtype=np.float64)
    intervals = np.stack([numbers - 1, numbers + 1], axis=1) if known else None
    return JointEstimate(name, "prismatic", "a", "b", numbers, None, intervals, numbers, numbers)


def row(name: str, verdict: str = CERTAIN, **members: Any) -> Told:
    return Told(name=name, verdict=verdict, sentence=f"of {name}", **members)


class Page(HTMLParser):
    """What elements there are, with their attributes, and what text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def test_the_worst_come_first() -> None:
    rows = [row(f"row {k}", verdict) for k, verdict in enumerate(reversed(VERDICTS))]
    page = Page(report(rows, "t"))
    at = [page.text.index(one.name) for one in reversed(rows)]
    assert at == sorted(at)
    assert [text for text in page.text if text.endswith(" (1)")] == [f"{HEADINGS[verdict]} (1)" for verdict in VERDICTS]
    links = [attributes["href"] for tag, attributes in page.elements if tag == "a"]
    ids = {attributes.get("id") for _, attributes in page.elements}
    assert all(link[1:] in ids for link in links if link is not None and link.startswith("#"))


def test_joints_beyond_the_first_are_folded_in() -> None:
    standings = tuple((f"joint j{number}", f"{number} cm") for number in range(8))
    page = Page(report([row("a", standings=standings)], "t"))
    assert "2 more" in page.text and "7 cm" in page.text


@given(name=TEXT, sentence=TEXT, model=TEXT, place=TEXT, title=TEXT)
def test_names_are_text(name: str, sentence: str, model: str, place: str, title: str) -> None:
    told = Told(
        name=name,
        verdict=ERROR,
        sentence=sentence,
        model=model,
        standings=((f"joint {place}", place),),
        result=f"results/{name}.json",
        picture=f"pictures/{name}.png",
    )
    page = Page(report([told], title))
    assert {tag for tag, _ in page.elements} <= ELEMENTS
    assert not any(attribute.startswith("on") for _, attributes in page.elements for attribute in attributes)
    for tag, attributes in page.elements:
        where = attributes.get("href") or attributes.get("src") or "#"
        assert where.startswith(("#", "results/", "pictures/", "table.csv")), (tag, where)


def test_words_stand_out_in_light_and_dark() -> None:
    for colours in STYLE.split("@media (prefers-color-scheme: dark)")[:2]:
        named = {
            name: rgb(value[:7])
            for name, value in (part.strip().split(": ", 1) for part in colours.split("--")[1:] if ": #" in part)
        }
        for ground in ("ground", "sheet"):
            for word in ("ink", "quiet", "accent", "good", "fair", "bad"):
                assert contrast(named[word], named[ground]) >= 4.5, (word, ground)


def test_a_table_has_every_joint_of_any_row() -> None:
    rows = [
        row("a", joints=(joint("slide"),), explained=0.5, certain=1, links=2),
        row("b", WAITING),
        row("c", ERROR),
        row("d", joints=(joint("floor", 3), joint("slide", known=False))),
    ]
    a, b, c, d = csv.DictReader(io.StringIO(table(rows)))
    assert list(a)[: len(COLUMNS)] == list(COLUMNS)
    assert list(a)[len(COLUMNS) :][:4] == ["slide position", "slide low", "slide high", "floor 0 position"]
    assert (a["slide position"], a["slide low"], a["slide high"], a["floor 2 high"]) == ("0.0", "-1.0", "1.0", "")
    assert (b["verdict"], b["sentence"], b["error"], b["slide position"]) == ("waiting", "of b", "", "")
    assert (c["sentence"], c["error"]) == ("", "of c")
    assert (d["floor 2 position"], d["floor 2 high"], d["slide low"]) == ("2.0", "3.0", "")


@pytest.mark.parametrize("name", ["=1+1", "+1", "-1", "@x", "\tx"])
def test_no_name_becomes_a_formula(name: str) -> None:
    ((*_, last), cells) = csv.reader(io.StringIO(table([row(name, joints=(joint(name),))])))
    assert cells[0] == f"'{name}" and last == f"'{name} high"
    assert cells[-2] == "-1.0"  # a number stays one
