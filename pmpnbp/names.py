"""Names of links, joints, models and frames: what can be one, and how some of them stand in a sentence."""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence

# Longer than any file name, and than the names of robots' links.
LONGEST_NAME = 255
# Control characters, halves of surrogate pairs, which are no text, and ends of lines and paragraphs.
_NOT_IN_NAMES = ("Cc", "Cs", "Zl", "Zp")


def name_fault(name: str) -> str | None:
    """What keeps `name` from being a name, to be said behind it; None where nothing does."""
    if name in (".", ".."):
        return "is a step of a path, which no address can hold"
    if len(name) > LONGEST_NAME:
        return f"has {len(name)} characters; expected at most {LONGEST_NAME}"
    return character_fault(name)


def character_fault(text: str) -> str | None:
    """What of one line's text cannot be in a name, to be said behind it; None where nothing is."""
    odd = next((character for character in text if unicodedata.category(character) in _NOT_IN_NAMES), None)
    if odd is not None:
        return f"has the character U+{ord(odd):04X}; expected no control characters and no halves of surrogate pairs"
    return None


def some_of(names: Sequence[str]) -> str:
    """The first three of some names, as part of a sentence."""
    return ", ".join(names[:3]) + (" and others" if len(names) > 3 else "")
