"""How is the text of an option read? A function for each kind, whose complaint argparse puts into its sentence."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

from app.server_config import convert
from pmpnbp.errors import PmpnbpError
from pmpnbp.settings import SessionOptions

Value = TypeVar("Value")


def option(name: str) -> str:
    """`max_std` as --max-std."""
    return f"--{name.replace('_', '-')}"


def checked(read: Callable[[str], Value], holds: Callable[[Value], bool], expected: str) -> Callable[[str], Value]:
    """Reads an option whose text is `expected`, where `holds` is true of what `read` makes of it."""

    def parse(text: str) -> Value:
        with suppress(ValueError):
            value = read(text)
            if holds(value):
                return value
        raise argparse.ArgumentTypeError(f"{text!r} is not {expected}")

    return parse


def whole(low: int, high: int) -> Callable[[str], int]:
    """Reads a whole number from `low` to `high`."""
    return checked(int, lambda number: low <= number <= high, f"a whole number from {low} to {high}")


def within(name: str, low: int | None = None) -> Callable[[str], int]:
    """Reads the whole number that an option is, from `low` on where that is another limit than its own."""
    about = next(entry.metadata for entry in fields(SessionOptions) if entry.name == name)
    return whole(about["low"] if low is None else low, about["high"])


def server_value(name: str) -> Callable[[str], Any]:
    """Reads the entry of this name of the server's configuration."""

    def parse(text: str) -> Any:
        try:
            return convert(name, text, "it")
        except PmpnbpError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return parse


def assignment(text: str) -> tuple[str, str]:
    """Reads `NAME=VALUE`. Raises argparse.ArgumentTypeError for anything else."""
    name, separator, value = text.partition("=")
    if not separator or not name.strip():
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    return name.strip(), value.strip()


# How an option's value is read, and what stands for it in the help, where it is not one of a few words.
OPTIONS: dict[str, tuple[Callable[[str], Any], str]] = {
    "particles": (within("particles"), "N"),
    "iterations": (within("iterations", low=0), "N"),  # none at all give the start
    "seed": (within("seed"), "N"),
    "roi": (
        checked(
            lambda text: [float(number) for number in text.split(",")],
            lambda numbers: len(numbers) == 6 and all(map(math.isfinite, numbers)),
            "six finite numbers with commas between, X0,Y0,Z0,X1,Y1,Z1",
        ),
        "X0,Y0,Z0,X1,Y1,Z1",
    ),
    "prior": (Path, "FILE"),
    "max_std": (checked(float, lambda metres: 0 < metres < math.inf, "a finite number of metres above zero"), "METRES"),
}
