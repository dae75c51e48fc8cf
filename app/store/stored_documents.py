"""Is what an entry's JSON file says of the kind that the server wrote? One that is not is damaged, as one cut off is.

What is left out is another matter: an older server wrote less.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, TypeAdapter, ValidationError, with_config
from typing_extensions import TypedDict  # pydantic asks for this one before Python 3.12

from pmpnbp.inference.arrival import ScanMode
from pmpnbp.settings import Method


@with_config(strict=True)
class _Change(TypedDict, total=False):
    after_iteration: int
    config: dict[str, Any] | None
    scan_id: str | None
    mode: ScanMode


@with_config(strict=True)
class _Stored(TypedDict, total=False):
    id: str
    created: str
    # of an upload
    file: str
    file_name: str
    # of a recording, and of a session
    method: Method
    particles: int
    seed: int
    # of a session
    name: str | None
    model_id: str
    scan_ids: list[str]
    iterations: int | None
    roi: list[float] | None
    prior: dict[str, Any] | None
    config: dict[str, Any] | None
    max_std: float | None
    truth: dict[str, Any] | None
    changes: list[_Change] | None
    events: Annotated[int, Field(ge=1)]


_STORED = TypeAdapter(_Stored)


def is_sound(document: dict[str, Any]) -> bool:
    """Whether every member of a model's, scan's, recording's or session's document is of its kind."""
    try:
        _STORED.validate_python(document)
    except ValidationError:
        return False
    return True
