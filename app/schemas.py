"""What do calls about sessions take and give? Every member with its unit and frame; /docs is made of this."""

from __future__ import annotations

import json
import math
from dataclasses import fields
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from pmpnbp.settings import Method, SessionOptions

Finite = Annotated[float, Field(allow_inf_nan=False)]
Until = Literal["iterations", "converged", "certain"]
State = Literal["paused", "waiting", "running", "failed", "recorded"]
Certain = Annotated[bool, Field(description="whether every std_xyz is at most max_std")]
Covariance = Annotated[
    list[float],
    Field(
        description="row-major 6x6 over x, y, z (metres) and rotation about fixed X, Y, Z (radians), in world, as "
        "ROS's PoseWithCovariance",
        min_length=36,
        max_length=36,
    ),
]
NumberOrAxes = float | list[float]


def _plain(value: Any) -> Any:
    try:
        json.dumps(value, ensure_ascii=False, allow_nan=False).encode("utf-8")
    except (ValueError, RecursionError):
        raise ValueError("it holds a number that is not finite, or text that is no text") from None
    return value


Config = Annotated[
    dict[str, bool | int | float | str],
    AfterValidator(_plain),
    Field(
        description="settings by name, as GET /api/v1/settings lists them; `preset` (robust, paper) is applied first",
        examples=[{"anneal_iterations": 10}],
        max_length=100,
    ),
]
Members = Annotated[dict[str, Any], AfterValidator(_plain)]


def _option(name: str, more: str = "", **limits: Any) -> Any:
    """The member of a request that is the option `name`: its default, limits and help; `more` is what REST adds."""
    entry = next(entry for entry in fields(SessionOptions) if entry.name == name)
    low, high = entry.metadata["low"], entry.metadata["high"]
    limits = {"ge": low if math.isfinite(low) else None, "le": high if math.isfinite(high) else None} | limits
    return Field(entry.default, description=entry.metadata["help"] + more, **limits)


class Body(BaseModel):
    """A request's body: members that are not known are refused."""

    model_config = ConfigDict(extra="forbid")


class SessionRequest(Body):
    """What a session is to look at, and how."""

    model_id: str = Field(description="id of the model", max_length=64, examples=["0123456789abcdef"])
    scan_ids: list[Annotated[str, Field(max_length=64)]] = Field(
        description="ids of the scans: views of one scene in one world frame",
        min_length=1,
        max_length=32,
        examples=[["0123456789abcdef"]],
    )
    name: str | None = Field(None, description="what people call it", max_length=200, examples=["kitchen"])
    method: Method = _option("method")
    particles: int = _option("particles")
    iterations: int = _option("iterations", "; `run` makes so many where it is told no number")
    seed: int = _option("seed")
    roi: list[Finite] | None = _option(
        "roi", "; null for the default", min_length=6, max_length=6, examples=[[-0.1, -0.2, -0.1, 0.9, 0.7, 0.9]]
    )
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

    iterations: int | None = Field(
        None,
        description="iterations to make from here; without it up to the session's own number, that many where it has "
        "made them",
        ge=1,
        le=100_000,
        examples=[100],
    )
    until: Until = Field(
        "iterations", description="stop before that as soon as the inference is at rest, or every link certain"
    )


class StepRequest(Body):
    """How many iterations to wait for."""

    iterations: int = Field(1, description="iterations to make", ge=1, le=1000)


class ChangeRequest(Body):
    """Settings to change."""

    config: Config


class AddScanRequest(Body):
    """A further view."""

    scan_id: str = Field(description="id of the scan", max_length=64, examples=["0123456789abcdef"])


class Progress(BaseModel):
    """The part of a session that changes by itself."""

    state: State = Field(
        description="waiting: wants to iterate, and does as soon as fewer sessions run; failed: see error; recorded: "
        "an uploaded recording, which does not iterate"
    )
    iteration: int | None = Field(description="the newest one; 0 is the start; null where its recording is lost")
    iterations: int = Field(description="the iteration at which the present or last run ends")
    until: Until = Field(description="what ends the run before that")
    converged: bool = Field(
        description="whether the inference has come to rest; not so after a change that no iteration has seen yet"
    )
    certain: Certain
    error: str | None = Field(description="one sentence, where it is failed")
    position: int | None = Field(description="place among those that wait, 1 for the next; null where it does not")


class Session(Progress):
    """A session: a model, scans, and beliefs about where the model's links are."""

    id: str = Field(description="16 hexadecimal digits", examples=["0123456789abcdef"])
    kind: Literal["session", "recording"] = Field(description="recording: an uploaded one, which can only be read")
    name: str | None = Field(description="what people call it")
    view_url: str = Field(description="path of its page", examples=["/sessions/0123456789abcdef/"])
    model_id: str | None = Field(description="id of the model; null where the document is damaged, and of a recording")
    scan_ids: list[str] = Field(description="ids of the scans, those added later too; empty of a recording")
    method: str | None = Field(description="how it infers")
    particles: int | None = Field(description="particles of each part")
    seed: int | None = Field(description="of its random numbers")
    roi: list[float] | None = Field(description="region of interest x0 y0 z0 x1 y1 z1, metres in world")
    prior: dict[str, Any] | None = Field(description="as prior.json")
    config: dict[str, Any] = Field(description="settings in force from the next iteration on, as they were given")
    max_std: float | None = Field(description="metres: a link is certain where no element of its std_xyz is above")
    created: str | None = Field(description="when it was made, UTC, ISO 8601", examples=["2024-05-01T12:00:00.000Z"])


class Position(BaseModel):
    """A point, metres."""

    x: float = Field(description="metres")
    y: float = Field(description="metres")
    z: float = Field(description="metres")


class Orientation(BaseModel):
    """A unit quaternion."""

    x: float = Field(description="the vector part along x")
    y: float = Field(description="the vector part along y")
    z: float = Field(description="the vector part along z")
    w: float = Field(description="the scalar part, not negative", ge=0)


class Pose(BaseModel):
    """pose_world_link: takes the link's coordinates to world."""

    position: Position
    orientation: Orientation


class Mode(BaseModel):
    """One hypothesis of a link."""

    weight: float = Field(description="its share, 0 to 1")
    pose: Pose
    covariance: Covariance


class LinkEstimate(BaseModel):
    """A link of the URDF."""

    pose: Pose
    covariance: Covariance
    std_xyz: list[float] = Field(description="standard deviations along world's axes, metres", min_length=3)
    certain: Certain
    visible_fraction: float | None = Field(
        description="share of its surface towards the camera that was seen, 0 to 1; null where no surface moves with it"
    )
    log_likelihood: float | None = Field(
        description="natural logarithm of the unary potential at the estimate; null as visible_fraction"
    )
    modes: list[Mode] = Field(description="hypotheses, heaviest first")


class JointEstimate(BaseModel):
    """A moving joint: metres for slides, radians for turns; planar and floating ones have a list of three or six."""

    type: str = Field(description="revolute, continuous, prismatic, planar or floating")
    position: NumberOrAxes = Field(description="metres or radians")
    std: NumberOrAxes = Field(description="standard deviation, metres or radians")
    lower: NumberOrAxes = Field(description="limit, metres or radians")
    upper: NumberOrAxes = Field(description="limit, metres or radians")
    parent: str = Field(description="the link it hangs on")
    child: str = Field(description="the link it moves")


class NuisanceEstimate(BaseModel):
    """What sensor or model have wrong everywhere at once, as far as it was told: a share, metres or radians."""

    value: float = Field(description="what it is taken for")
    std: float = Field(description="standard deviation given the scan, by the curvature of the score")
    prior_std: float = Field(description="standard deviation before the scan, about 0")


class Estimate(BaseModel):
    """result.json, with the session it comes from."""

    schema_: str = Field(alias="schema", description="name and version of this form", examples=["pmpnbp/estimate-1"])
    model: str = Field(description="the model's name")
    method: str = Field(description="how it was inferred")
    seed: int = Field(description="of the random numbers")
    iteration: int = Field(description="the iteration this is of; 0 is the start")
    converged: bool = Field(description="whether the inference had come to rest")
    frame_id: str = Field(description="name of the world frame that poses are in", examples=["world"])
    stamp: float | None = Field(description="of the newest scan, seconds")
    certain: Certain
    max_std: float = Field(description="metres, up to which a link is certain")
    seconds: float = Field(description="wall time of the inference so far")
    links: dict[str, LinkEstimate] = Field(description="every link of the URDF, by name")
    joints: dict[str, JointEstimate] = Field(description="every moving joint, by name")
    depth_noise: list[float] = Field(
        description="of each view, metres: standard deviation of its depths at the object, that the inference goes by"
    )
    nuisances: dict[str, NuisanceEstimate] = Field(
        description="depth_scale/VIEW, camera/VIEW/AXIS and size/PART, where the settings leave them free"
    )
    truth: dict[str, Any] | None = Field(None, description="errors, where the truth is known: ADD in metres by part")
    session_id: str = Field(description="the session")
    state: State = Field(description="what the session was doing when it was asked")


class Particles(BaseModel):
    """Weighted poses."""

    session_id: str = Field(description="the session")
    iteration: int = Field(description="the iteration they are of")
    frame_id: str = Field(description="name of the world frame")
    particles: list[list[float]] = Field(description="x y z qw qx qy qz each, metres, link in world")
    log_weights: list[float | None] = Field(
        description="natural logarithms of the weights, which sum to 1; null for a weight of 0"
    )
    log_unary: list[float | None] = Field(description="natural logarithm of the unary potential, before tempering")


class BeliefParticles(Particles):
    """The belief about one link."""

    link: str = Field(description="the link")
    part: str = Field(description="the part it moves with")


class MessageParticles(Particles):
    """What one part says about where another is: poses of the receiver's link."""

    sender: str = Field(alias="from", description="the part that says it")
    receiver: str = Field(alias="to", description="the part it is about")
    link: str = Field(description="the link that the poses are of")
    log_neighbour: list[float | None] = Field(
        description="natural logarithm of the factor that the sender's other neighbours make"
    )


class TraceRow(BaseModel):
    """An iteration at a glance."""

    event: int = Field(description="number of its event")
    iteration: int = Field(description="its number; 0 is the start")
    stage: str = Field(description="start, search, belief propagation, refine or particle filter")
    seconds: float = Field(description="wall time of the iteration")
    elapsed: float = Field(description="wall time of all so far, with reading them out, seconds")
    tolerance: float = Field(description="distance at which a pixel stops to be explained, metres")
    effective_sample_size: dict[str, float | None] = Field(description="by part, particles")
    log_likelihood: float | None = Field(description="log score of the object as a whole; null where there is none")
    std_xyz: dict[str, list[float]] = Field(description="by link, standard deviations along world's axes, metres")
    add: dict[str, float] | None = Field(description="by part, metres (eq. 12); null where the truth is not known")
    converged: bool = Field(description="whether the inference had come to rest")
    certain: Certain
    notes: list[str] = Field(description="what the inference had to remark")


class TraceChange(BaseModel):
    """What was changed on the way: settings, or a view that came."""

    after_iteration: int = Field(description="iterations beyond this one are made with the change")
    config: dict[str, Any] | None = Field(None, description="settings by name, where some were changed")
    scan_id: str | None = Field(
        None, description="id of the scan, where one was added; `view N` in an uploaded recording, which knows no ids"
    )


class Trace(BaseModel):
    """All iterations at a glance."""

    session_id: str = Field(description="the session")
    changes: list[TraceChange] = Field(description="what was changed on the way, in order")
    iterations: list[TraceRow] = Field(description="ascending")


class View(BaseModel):
    """A place to look from."""

    pose: Pose
    expected_gain_nats: float = Field(description="information that a scan from there is expected to bring")
    expected_std_xyz: dict[str, list[float]] = Field(description="by link, metres, after such a scan")


class Decision(BaseModel):
    """Whether to act on the estimate."""

    session_id: str = Field(description="the session")
    iteration: int = Field(description="the iteration this is decided by")
    action: Literal["act", "look"] = Field(description="act where all asked links are certain, else look again")
    certain: bool = Field(description="whether all asked links are certain")
    max_std: float = Field(description="metres, up to which a link is certain")
    links: list[str] = Field(description="the links that were asked about")
    blocking: list[str] = Field(description="those of them that are not certain")
    views: list[View] = Field(description="where to look from next, best first; empty in this version")
