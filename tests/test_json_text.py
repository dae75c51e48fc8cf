"""What is read as JSON can be written again; what cannot is refused, wherever it stands."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pmpnbp.json_text import json_bytes, read_json
from pmpnbp.names import LONGEST_NAME, name_fault

# Halves of surrogate pairs among the rest.
ANY_TEXT = st.text(st.characters(exclude_categories=()), max_size=5)
VALUES = st.recursive(
    ANY_TEXT | st.integers() | st.none(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(ANY_TEXT, inner, max_size=3),
    max_leaves=8,
)


def can_be_written(value: Any) -> bool:
    try:
        json.dumps(value, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        return False
    return True


@given(VALUES, st.booleans())
def test_what_is_read_can_be_written(value: Any, escaped: bool) -> None:
    text = json.dumps(value, ensure_ascii=escaped)
    # two halves side by side are a whole once they are escaped
    expected = json.loads(text)
    if can_be_written(expected):
        assert read_json(text) == expected
        assert json.loads(json_bytes(read_json(text))) == expected
    else:
        with pytest.raises(UnicodeEncodeError):
            read_json(text)


@given(st.recursive(st.floats() | ANY_TEXT | st.integers(), lambda inner: st.lists(inner, max_size=3), max_leaves=8))
def test_whatever_is_told_is_written(value: Any) -> None:
    """Numbers to the last bit, what is none as null, and what is no text as question marks."""

    def told(one: Any) -> Any:
        if isinstance(one, list):
            return [told(inner) for inner in one]
        if isinstance(one, float):
            return one if math.isfinite(one) else None
        return one.encode("utf-8", "replace").decode() if isinstance(one, str) else one

    assert json.loads(json_bytes(value)) == told(value)


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "1" * 5000, "nul"])
def test_what_is_none_is_a_value_error(text: str) -> None:
    with pytest.raises(ValueError):  # each by another sentence
        read_json(text)


@pytest.mark.parametrize(
    "name", ["robot/drawer1", "a b", "Schublade ü", "抽屉", "100%", "x?y#z", "a/../b", "👋", "n" * 255]
)
def test_names_of_robots_are_names(name: str) -> None:
    assert name_fault(name) is None


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("n" * (LONGEST_NAME + 1), "has 256 characters; expected at most 255"),
        ("..", "is a step of a path"),
        ("a\0b", "has the character U+0000"),
        ("a\nb", "has the character U+000A"),
        ("a\x85", "has the character U+0085"),
        ("\u2028", "has the character U+2028"),
        ("\ud800", "has the character U+D800"),
    ],
)
def test_other_text_is_no_name(name: str, fault: str) -> None:
    assert fault in (name_fault(name) or "")
