"""Are two recorded values the same, to the bit?"""

from __future__ import annotations

from dataclasses import fields

import numpy as np


def assert_same(a: object, b: object, without: tuple[str, ...] = ()) -> None:
    """All fields alike, arrays to the bit."""
    assert type(a) is type(b)
    for entry in fields(a):  # type: ignore[arg-type]
        if entry.name in without:
            continue
        mine, theirs = getattr(a, entry.name), getattr(b, entry.name)
        if isinstance(mine, np.ndarray):
            assert (mine.dtype, mine.shape) == (theirs.dtype, theirs.shape), entry.name
            assert mine.tobytes() == theirs.tobytes(), entry.name
        elif hasattr(mine, "__dataclass_fields__"):
            assert_same(mine, theirs)
        elif isinstance(mine, tuple) and mine and hasattr(mine[0], "__dataclass_fields__"):
            for one, other in zip(mine, theirs, strict=True):
                assert_same(one, other)
        else:
            assert mine == theirs or (mine != mine and theirs != theirs), entry.name
