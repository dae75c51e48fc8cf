"""What does a row of the trace come to, and is what a recording from elsewhere says of an iteration one? Who wrote that
is not known."""

from __future__ import annotations

import json
from typing import Any

from pydantic import ValidationError

from app.schemas_results import TraceRow
from pmpnbp.json_text import read_json
from pmpnbp.readout.snapshot import Row
from pmpnbp.recording.trace_rows import event_of
from pmpnbp.scene.articulated_object import ArticulatedObject


def verdict(row: Row, changed: bool = False) -> dict[str, Any]:
    """What REST says of the newest iteration; nothing is found any more where something was `changed` since."""
    return {
        "phase": "settling" if changed and row["phase"] == "at rest" else row["phase"],
        "converged": row["converged"] and not changed,
        "certain": row["certain"] and not changed,
        "fit": None if changed else row["fit"],
        "fit_reason": None if changed else row["fit_reason"],
    }


def row_of(text: str, model: ArticulatedObject) -> Row | None:
    """The row of the trace that `text` is, where it is one, about this model; its event is that of `event_of`."""
    try:
        row = TraceRow.model_validate(read_json(text)).model_dump()
        json.dumps(row, allow_nan=False)
    except (ValueError, ValidationError, RecursionError):
        return None
    if not 0 <= row["iteration"] < 2**31 or set(row["effective_sample_size"]) != {part.name for part in model.parts}:
        return None
    for stds in (row["std_xyz"], row["particle_std_xyz"]):
        if stds is not None and (set(stds) != set(model.links) or any(len(axes) != 3 for axes in stds.values())):
            return None
    certain, told = row["certain_by_link"], row["posterior_iteration"]
    if certain is not None and (told is None or set(certain) != set(model.links)):
        return None
    if (told is None) != (row["std_xyz"] is None) or (told is not None and not 0 <= told <= row["iteration"]):
        return None
    return {**row, "event": event_of(row["iteration"])}
