"""What can be the name of a link, a joint, a model or a frame? Text that a list, an address and a sentence can hold."""

from __future__ import annotations

import unicodedata

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
    odd = next((character for character in name if unicodedata.category(character) in _NOT_IN_NAMES), None)
    if odd is not None:
        return f"has the character U+{ord(odd):04X}; expected no control characters and no halves of surrogate pairs"
    return None
