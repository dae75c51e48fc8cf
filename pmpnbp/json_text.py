"""JSON as it comes in and as it leaves the program: text that can be written as UTF-8, either way.

JSON can name half of a surrogate pair, as in `"\\ud800"`, which is no text: it would be read without a word, and fail
whoever writes it. So it is refused where it comes in. NaN and infinities, which JSON does not have, leave as null.
"""

from __future__ import annotations

import json
import math
import re
from typing import Any

# ten times as fast as Python's own, where a server writes a result with every iteration
from pydantic_core import PydanticSerializationError, to_json


def read_json(text: str) -> Any:
    """What the JSON `text` says. Raises ValueError where it is none or nested too deep; UnicodeEncodeError, which is
    one, where it holds half of a surrogate pair."""
    try:
        value = json.loads(text)
    except RecursionError:
        raise ValueError("nested too deep") from None
    if "\\u" in text or not text.isascii():
        check_text(value)
    return value


def check_text(value: Any) -> None:
    """Raise UnicodeEncodeError where a string in the JSON `value`, a member's name too, is no text."""
    waiting = [value]
    while waiting:
        found = waiting.pop()
        if isinstance(found, str):
            found.encode()
        elif isinstance(found, dict):
            waiting += found
            waiting += found.values()
        elif isinstance(found, list):
            waiting += found


def json_bytes(value: Any) -> bytes:
    """`value` as compact JSON. What is no text, as in a recording that another program wrote, leaves as `?`."""
    try:
        return to_json(value, inf_nan_mode="null")
    except PydanticSerializationError:
        return json.dumps(without_nan(value), ensure_ascii=False, separators=(",", ":")).encode("utf-8", "replace")


def json_to_read(value: Any) -> str:
    """`value`, in which every number is finite, as JSON with a member a line, and a list of numbers in one: a
    covariance would be 36 lines."""
    text = json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    return re.sub(r"\[\n[-+\d.e,\s]+\]", lambda found: re.sub(r"\n\s*", "", found[0]).replace(",", ", "), text)


def without_nan(value: Any) -> Any:
    """`value` with None where a number is not finite."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {name: without_nan(member) for name, member in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(member) for member in value]
    return value
