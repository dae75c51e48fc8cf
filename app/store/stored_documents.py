"""Is what an entry's JSON file says of the kind that the server wrote? One that is not is damaged, as one cut off is.

What is left out is another matter: an older server wrote less.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pmpnbp.inference.arrival import ScanMode
from pmpnbp.settings import Method


class _Change(BaseModel):
    model_config = ConfigDict(strict=True)

    after_iteration: int
    config: dict[str, Any] | None = None
    scan_id: str | None = None
    mode: ScanMode = "joins"


class _Stored(BaseModel):
    model_config = ConfigDict(strict=True)

    id: str = ""
    created: str = ""
    # of an upload
    file: str = ""
    file_name: str = ""
    # of a recording, and of a session
    method: Method = "pmpnbp"
    particles: int = 0
    seed: int = 0
    # of a session
    name: str | None = None
    tags: list[str] | None = None
    sample: str | None = None
    model_id: str = ""
    scan_ids: list[str] = []
    iterations: int | None = None
    roi: list[float] | None = None
    prior: dict[str, Any] | None = None
    config: dict[str, Any] | None = None
    max_std: float | None = None
    truth: dict[str, Any] | None = None
    changes: list[_Change] | None = None
    events: Annotated[int, Field(ge=1)] = 1


def is_sound(document: dict[str, Any]) -> bool:
    """Whether every member of a model's, scan's, recording's or session's document is of its kind."""
    try:
        _Stored.model_validate(document)
    except ValidationError:
        return False
    return True
