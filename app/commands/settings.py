"""`pmpnbp settings`: every entry of `pmpnbp.settings.Settings` as lines of text."""

from __future__ import annotations

import argparse
import sys
from dataclasses import fields

from pmpnbp.settings import Settings


def run(_: argparse.Namespace) -> int:
    """Print the table; return 0."""
    sys.stdout.write(table())
    return 0


def table() -> str:
    """One entry a block: name, default, unit, the paper's value where it differs; then its line of help."""
    lines = [
        "Settings for --config NAME=VALUE. Defaults are those of preset=robust; preset=paper takes the paper's values.",
        "",
    ]
    for entry in fields(Settings):
        about = entry.metadata
        unit = f" {about['unit']}" if about["unit"] else ""
        choices = f" ({' or '.join(about['choices'])})" if about["choices"] else ""
        paper = "" if about["paper"] == entry.default else f"; paper: {_text(about['paper'])}{unit}"
        lines += [f"{entry.name} = {_text(entry.default)}{unit}{choices}{paper}", f"    {about['help']}"]
    return "\n".join(lines) + "\n"


def _text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
