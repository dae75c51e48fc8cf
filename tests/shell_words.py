"""Commands that a text shows, as the words of which a shell would call the program."""

from __future__ import annotations

import shlex
from collections.abc import Iterator


def commands(text: str) -> Iterator[list[str]]:
    """Each line of `text` by its words, without comments; lines that end with a backslash go on in the next one. Where
    what is printed goes is left out, and so are empty lines."""
    for line in text.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if ">" in words:
            words = words[: words.index(">")]
        if words:
            yield words
