"""What do calls about sessions take and give? Every member with its unit and frame; /docs is made of this."""

from __future__ import annotations

import json
import math
from dataclasses import fields
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, StringConstraints, model_validator

from pmpnbp.inference.arrival import ScanMode
from pmpnbp.json_text import check_text
from pmpnbp.names import character_fault
from pmpnbp.readout.snapshot import Phase
from pmpnbp.settings import Method, SessionOptions

# strict: neither true nor "1" is a number
Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Coordinate = Annotated[Finite, Field(ge=-1e3, le=1e3, description="metres")]
UnitComponent = Annotated[Finite, Field(ge=-1.001, le=1.001)]
Until = Literal["iterations", "converged", "certain"]
State = Literal["paused", "waiting", "running", "failed", "recorded"]
Certain = Annotated[
    bool,
    Field(
        description="whether the fit is good, every std_xyz and expected_add at most max_std, no other mode of over 1 %"
        " elsewhere, and what is longer than 10 cm is not turned, by more than 2° for each 2.5 mm of max_std; false"
        " where there is no posterior"
    ),
]
Fit = Literal["good", "doubtful", "none"]
FitOrNull = Annotated[
    Fit | None, Field(description="whether what should be seen is seen; null where there is no posterior")
]
FitReason = Annotated[str | None, Field(description="why, in a sentence")]
NumberOrAxes = float | list[float]


def _plain(value: Any) -> Any:
    try:
        json.dumps(value, allow_nan=False)
    except (ValueError, RecursionError):
        raise ValueError("it holds a number that is not finite, or is nested too deep") from None
    return value


def _settings(value: Any) -> Any:
    """Refused in one sentence, where each of the types that a value may have would give one of its own."""
    for name, given in value.items() if isinstance(value, dict) else ():
        if not isinstance(given, bool | int | float | str):
            raise ValueError(f"'{name!s:.60}' is {given!r:.60}; expected a number, a word, true or false")
    return value


Config = Annotated[
    dict[str, bool | int | float | str],
    BeforeValidator(_settings),
    AfterValidator(_plain),
    Field(
        description="settings by name, as GET /api/v1/settings lists them; `preset` (robust, paper) is applied first",
        examples=[{"anneal_iterations": 10}],
        max_length=100,
    ),
]


def _one_line(text: str) -> str:
    if fault := character_fault(text.strip()):
        raise ValueError(f"it {fault}")
    return text


def _number(value: Any) -> Any:
    if isinstance(value, bool | str):
        raise ValueError("input should be a whole number")
    return value


# strict as Finite is, but for 1.0, which JSON does not tell from 1
Whole = Annotated[int, BeforeValidator(_number)]
Name = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=200), AfterValidator(_one_line)]
Tag = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=40), AfterValidator(_one_line)]
Tags = Annotated[
    list[Tag],
    AfterValidator(lambda tags: list(dict.fromkeys(tags))),
    Field(
        description="words that it is found by; one that comes twice counts once", examples=[["kitchen"]], max_length=20
    ),
]
Roi = Annotated[list[Finite], Field(min_length=6, max_length=6, examples=[[-0.1, -0.2, -0.1, 0.9, 0.7, 0.9]])]
Members = Annotated[dict[str, Any], AfterValidator(_plain)]


def _option(name: str, more: str = "", **limits: Any) -> Any:
    """The member of a request that is the option `name`: its default, limits and help; `more` is what REST adds."""
    entry = next(entry for entry in fields(SessionOptions) if entry.name == name)
    low, high = entry.metadata["low"], entry.metadata["high"]
    limits = {"ge": low if math.isfinite(low) else None, "le": high if math.isfinite(high) else None} | limits
    return Field(entry.default, description=entry.metadata["help"] + more, **limits)


class Body(BaseModel):
    """A request's body: members that are not known are refused, and so is what is no text, wherever it stands."""

    model_config = ConfigDict(extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _is_text(cls, members: Any) -> Any:
        try:
            check_text(members)
        except UnicodeEncodeError:
            raise ValueError("it holds half of a surrogate pair, such as '\\ud800'; expected text") from None
        return members


# Views that a session begins with, at most.
MOST_SCANS = 32


class SessionRequest(Body):
    """What a session is to look at, and how."""

    model_id: str = Field(description="id of the model", max_length=64, examples=["0123456789abcdef"])
    scan_ids: list[Annotated[str, Field(max_length=64)]] = Field(
        description="ids of the scans: views of one scene in one world frame, each once",
        min_length=1,
        max_length=MOST_SCANS,
        examples=[["0123456789abcdef"]],
        json_schema_extra={"uniqueItems": True},
    )
    name: Annotated[str, AfterValidator(_one_line)] | None = Field(
        None,
        description="what people call it; without one, or with spaces alone, it is called by the files of its model "
        "and scan",
        max_length=200,
        examples=["kitchen"],
    )
    tags: Tags = Field(default_factory=list)
    method: Method = _option("method")
    particles: Whole = _option("particles")
    iterations: Whole = _option("iterations", "; `run` makes so many where it is told no number")
    seed: Whole = _option("seed")
    roi: Roi | None = _option("roi", "; null for the default")
    prior: Members | None = _option(
        "prior",
        ": {kind: uniform, orientation: upright or any}, or {kind: gaussian, link, pose (of the link in world, metres, "
        "quaternion x y z w), std_xyz (metres), std_rpy (radians about world's axes), joints: {NAME: {position, std}} "
        "(metres or radians)}; null for the default",
        examples=[{"kind": "uniform", "orientation": "upright"}],
    )
    config: Config = Field(default_factory=dict)
    max_std: Finite = _option("max_std", "; metres", ge=None, gt=0)
    truth: Members | None = Field(
        None,
        description="where the links really are, where that is known: {links: {NAME: 4x4 T_world_link, row-major, "
        "metres}, joints: {NAME: metres or radians}}; the trace then tells the error",
    )


class RunRequest(Body):
    """How far to iterate."""

    iterations: Annotated[int, Field(ge=1, le=100_000), BeforeValidator(_number)] | None = Field(
        None,
        description="iterations to make from here; without it up to the session's own number, that many where it has "
        "made them",
        examples=[100],
    )
    until: Until = Field(
        "iterations",
        description="stop before that as soon as the inference is at rest, or every link certain; what stays at rest "
        "will not become certain, and stops, too",
    )


class StepRequest(Body):
    """How many iterations to wait for."""

    iterations: Whole = Field(1, description="iterations to make", ge=1, le=1000)


class ResetRequest(Body):
    """With what the session begins anew; what is not named stays as it is."""

    roi: Roi | None = _option("roi", "; null for the default")
    prior: Members | None = _option("prior", ", as prior.json; null for the default")
    method: Method = _option("method")
    particles: Whole = _option("particles")
    seed: Whole = _option("seed")


class ChangeRequest(Body):
    """What to change; at least one of them."""

    config: Config = Field(default_factory=dict)
    name: Name = Field(default_factory=str, description="what people call it")
    tags: Tags = Field(default_factory=list)

    @model_validator(mode="after")
    def _says_something(self) -> ChangeRequest:
        if not self.model_fields_set:
            raise ValueError("it names nothing to change; expected config, name or tags")
        return self


class RenameRequest(Body):
    """What people are to call it."""

    name: Name = Field(description="1 to 200 characters", examples=["top drawer"])


class AddScanRequest(Body):
    """A scan that has just been taken."""

    scan_id: str = Field(description="id of the scan", max_length=64, examples=["0123456789abcdef"])
    mode: ScanMode = Field(
        "joins",
        description="joins: another view of the same scene; replaces: the scene has moved on, and the scan counts "
        "instead of all before it",
    )


class PositionBody(Body):
    """A point, metres."""

    x: Coordinate
    y: Coordinate
    z: Coordinate


class OrientationBody(Body):
    """A unit quaternion."""

    x: UnitComponent = Field(description="the vector part along x")
    y: UnitComponent = Field(description="the vector part along y")
    z: UnitComponent = Field(description="the vector part along z")
    w: UnitComponent = Field(description="the scalar part")


class PoseBody(Body):
    """A pose in world."""

    position: PositionBody
    orientation: OrientationBody


class ViewBody(Body):
    """A place that a camera could look from."""

    pose: PoseBody = Field(description="pose_world_camera, optical: x right, y down, z forward")
    cost: Finite = Field(1.0, gt=0, le=1e6, description="what it takes to get there")


class DecisionRequest(Body):
    """What a planner wants to act on, and from where it could look instead."""

    links: list[str] | None = Field(None, min_length=1, max_length=1000, description="names; default: all")
    max_std: Finite | None = Field(None, gt=0, le=1e6, description="metres; default: the session's")
    views: list[ViewBody] | None = Field(
        None, min_length=1, max_length=100, description="ranked in the answer; default: views around the object"
    )
    iteration: Annotated[int, Field(ge=0, le=2**31), BeforeValidator(_number)] | None = Field(
        None, description="to decide by; default: the newest"
    )


class Progress(BaseModel):
    """The part of a session that its events tell of."""

    name: str | None = Field(description="what people call it; null where the document is damaged")
    state: State = Field(
        description="waiting: wants to iterate, and does as soon as fewer sessions run; failed: see error; recorded: "
        "an uploaded recording, which does not iterate"
    )
    iteration: int | None = Field(description="the newest one; 0 is the start; null where its recording is lost")
    phase: Phase | None = Field(
        description="of the newest iteration: searching: whole objects are tried all over the region; settling: one is "
        "left, and its parts move into place; null where its recording is lost"
    )
    iterations: int = Field(description="the iteration at which the present or last run ends")
    until: Until = Field(description="what ends the run before that")
    converged: bool = Field(
        description="whether the inference has come to rest; not so after a change that no iteration has seen yet"
    )
    certain: Certain
    fit: FitOrNull
    fit_reason: FitReason
    error: str | None = Field(description="one sentence, where it is failed")
    position: int | None = Field(description="place among those that wait, 1 for the next; null where it does not")
    reading_out: bool = Field(
        description="whether the posterior of an iteration at rest has been in the making for over half a second: that "
        "iteration comes once it is read out, and a call that changes the session does not wait for it"
    )


class Session(Progress):
    """A session: a model, scans, and beliefs about where the model's links are."""

    id: str = Field(description="16 hexadecimal digits", examples=["0123456789abcdef"])
    kind: Literal["session", "recording"] = Field(description="recording: an uploaded one, which can only be read")
    tags: list[str] = Field(default_factory=list, description="words that it is found by; none of a recording")
    view_url: str = Field(description="path of its page", examples=["/sessions/0123456789abcdef/"])
    model_id: str | None = Field(description="id of the model; null where the document is damaged, and of a recording")
    scan_ids: list[str] = Field(
        description="ids of the scans in force, those added later too and not those replaced; empty of a recording"
    )
    method: str | None = Field(description="how it infers")
    particles: int | None = Field(description="particles of each part")
    seed: int | None = Field(description="of its random numbers")
    roi: list[float] | None = Field(description="region of interest x0 y0 z0 x1 y1 z1, metres in world")
    prior: dict[str, Any] | None = Field(description="as prior.json")
    config: dict[str, Any] = Field(description="settings in force from the next iteration on, as they were given")
    max_std: float | None = Field(description="metres: a link is certain where std_xyz and expected_add are below")
    created: str | None = Field(description="when it was made, UTC, ISO 8601", examples=["2024-05-01T12:00:00.000Z"])
