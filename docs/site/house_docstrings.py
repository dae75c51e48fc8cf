"""Our docstrings in the words of Sphinx: lines `name : what it is` become a list, and what is indented becomes code;
and signatures as they are written.

Of a function and of a class that is made by calling it these are parameters, of a class of values its attributes, with
the types that they are annotated with.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
from typing import Any

from sphinx.application import Sphinx

# Names as the house writes them: one or several with commas, a colon between spaces
ENTRY = re.compile(r"(?P<names>\w+(?:, \w+)*) : (?P<text>.*)", re.DOTALL)
# Where a second entry begins on the line of a first one
NEXT = re.compile(r"; (?=\w+(?:, \w+)* : )")


def entries(paragraph: list[str]) -> list[tuple[list[str], str]] | None:
    """Names and text of each entry in a paragraph; None for a paragraph that is none. Lines that go on are indented."""
    joined: list[str] = []
    for line in paragraph:
        if line.startswith(" ") and joined:
            joined[-1] += " " + line.strip()
        else:
            joined.append(line.strip())
    found: list[tuple[list[str], str]] = []
    for line in joined:
        for text in NEXT.split(line):
            entry = ENTRY.fullmatch(text)
            if entry is None:
                return None
            found.append((entry["names"].split(", "), entry["text"]))
    return found


def paragraphs(lines: list[str]) -> list[list[str]]:
    """Runs of lines between empty ones."""
    found: list[list[str]] = [[]]
    for line in lines:
        if line.strip():
            found[-1].append(line)
        elif found[-1]:
            found.append([])
    return [paragraph for paragraph in found if paragraph]


def in_words_of_sphinx(lines: list[str], annotations: dict[str, Any] | None = None) -> list[str]:
    """A docstring's lines, rewritten. annotations : of a class of values, by attribute, all of which are listed"""
    prose: list[str] = []
    texts: dict[str, str] = {}
    for paragraph in paragraphs(lines):
        listed = entries(paragraph)
        if listed is not None:
            texts |= {name: text for names, text in listed for name in names}
        elif all(line.startswith("    ") for line in paragraph):
            prose += [".. code-block:: python", "", *paragraph, ""]
        else:
            prose += [*paragraph, ""]
    if annotations is None:
        return [*prose, *(f":param {name}: {text}" for name, text in texts.items()), ""]
    public = [name for name in annotations if not name.startswith("_")]
    told = [
        [f".. attribute:: {name}", f"   :type: {annotations[name]}", "", f"   {texts.get(name, '')}", ""]
        for name in public
    ]
    return [*prose, *(line for attribute in told for line in attribute)]


def rewrite(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Called by autodoc with the lines of a docstring, which it takes back."""
    annotations = (
        inspect.get_annotations(thing) if dataclasses.is_dataclass(thing) and isinstance(thing, type) else None
    )
    lines[:] = in_words_of_sphinx(lines, annotations)


class AsWritten(str):
    """An annotation that is shown as it stands in the source: by the names of our own types."""

    __repr__ = str.__str__


def signature(
    app: Sphinx, what: str, name: str, thing: Any, options: object, arguments: str | None, result: str | None
) -> tuple[str, str | None] | None:
    """Called by autodoc; the arguments and the result of a function, and of a class that is made by calling it."""
    if arguments is None or what not in ("function", "method", "class") or (what == "class" and arguments == "()"):
        return None
    found = inspect.signature(thing.__init__ if what == "class" else thing)
    shown = [
        one if one.annotation is one.empty else one.replace(annotation=AsWritten(one.annotation))
        for one in found.parameters.values()
        if one.name != "self"
    ]
    returned = None if what == "class" or found.return_annotation is found.empty else AsWritten(found.return_annotation)
    return str(inspect.Signature(shown)), returned


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", rewrite)
    app.connect("autodoc-process-signature", signature)
    return {"parallel_read_safe": True}
