"""What does a small JSON file say? Reads one object, and numbers out of it, with errors fit for a user."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path

from pmpnbp.errors import PmpnbpError
from pmpnbp.files import quoted, read_file
from pmpnbp.json_text import read_json

# A camera or a prior takes less than a thousandth of it.
LARGEST_FILE = 1 << 20


def read_object(path: Path, kind: str, failure: type[PmpnbpError]) -> Mapping[str, object]:
    """The object in the JSON file `path`; `kind` is what errors call the file ("camera file").

    Raises `failure` where the file cannot be read, is too large, or holds no JSON object.
    """
    name = f"{kind} {quoted(path)}"
    content = read_file(
        path, name, LARGEST_FILE, failure, beyond=f"{LARGEST_FILE} bytes, which no {kind} is", streams=True
    )
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise failure(f"{name} is not UTF-8 text; expected JSON") from error
    return parse_object(text, name, failure)


def parse_object(text: str, name: str, failure: type[PmpnbpError]) -> Mapping[str, object]:
    """The object in the JSON `text`, which errors call `name`. Raises `failure` where it holds none."""
    try:
        members = read_json(text)
    except json.JSONDecodeError as error:
        raise failure(f"{name} is not JSON (line {error.lineno}: {error.msg})") from error
    except UnicodeEncodeError as error:
        raise failure(f"{name} holds half of a surrogate pair, such as '\\ud800'; expected text") from error
    except ValueError as error:
        raise failure(f"{name} is not JSON that can be read: a number too long, or nested too deep") from error
    if not isinstance(members, Mapping):
        kind = "null" if members is None else f"a {type(members).__name__}"
        raise failure(f"{name} holds {kind}; expected an object {{…}}")
    return members


def finite_number(value: object) -> float | None:
    """`value` as a float where it is a finite JSON number that a float can hold, else None."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None
