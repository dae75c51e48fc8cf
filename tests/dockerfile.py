"""What does a Dockerfile say? Its instructions, for the tests that read them."""

from __future__ import annotations

import re
import shlex


def instructions(text: str) -> list[tuple[str, str]]:
    """Name and argument of each, continued lines joined, comments left out."""
    lines = "\n".join(line for line in text.splitlines() if not line.lstrip().startswith("#"))
    joined = re.sub(r"\\\n\s*", "", lines)
    return [(name, rest) for name, _, rest in (line.partition(" ") for line in joined.splitlines() if line.strip())]


def copy_parts(argument: str) -> tuple[dict[str, str], list[str], str]:
    """Options, sources and target of a COPY."""
    words = shlex.split(argument)
    options = dict(word[2:].split("=", 1) for word in words if word.startswith("--"))
    *sources, target = (word for word in words if not word.startswith("--"))
    return options, sources, target
