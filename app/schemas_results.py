"""What do calls about estimates, beliefs, the trace and decisions give? Every member with its unit and frame."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, computed_field

from app.schemas import Certain, FitOrNull, FitReason, NumberOrAxes, State
from pmpnbp.inference.arrival import ScanMode
from pmpnbp.readout.posterior import Doubt
from pmpnbp.readout.snapshot import Phase, phase_of

Covariance = Annotated[
    list[float],
    Field(
        description="row-major 6x6 over x, y, z (metres) and rotation about fixed X, Y, Z (radians), in world, as "
        "ROS's PoseWithCovariance",
        min_length=36,
        max_length=36,
    ),
]


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
    covariance: Covariance | None = Field(description="of the posterior; null where there is none, as all of its kind")
    std_xyz: list[float] | None = Field(
        description="the posterior's standard deviations along world's axes, metres", min_length=3
    )
    expected_add: float | None = Field(
        description="metres: distance over the surface (eq. 12) that the posterior expects the link to be off; null "
        "also where no surface moves with it"
    )
    certain: Certain
    doubts: list[Doubt] | None = Field(
        description="why it is not certain: the fit is not good, too few draws count, the scan sees through its part, "
        "or one that it hangs on, it looks the same in other modes' turns, a std_xyz or expected_add is above max_std, "
        "another mode has it elsewhere, or it may be turned; null where there is no posterior"
    )
    visible_fraction: float | None = Field(
        description="share of its surface towards the camera that nothing is in front of, 0 to 1, also where the scan "
        "sees through it, which `fit` tells; null where no surface moves with it"
    )
    log_likelihood: float | None = Field(
        description="natural logarithm of the unary potential at the estimate; null as visible_fraction"
    )
    modes: list[Mode] = Field(description="the posterior's hypotheses, heaviest first; empty where there is none")
    particle_std_xyz: list[float] = Field(
        description="spread of the algorithm's particles, metres, and no uncertainty", min_length=3
    )
    particle_modes: list[Mode] = Field(description="clusters among the particles, heaviest first")


class PosedLink(BaseModel):
    """Where a link is."""

    pose: Pose


class Alternative(BaseModel):
    """One hypothesis of the whole object."""

    weight: float = Field(description="its share of the posterior, 0 to 1")
    links: dict[str, PosedLink] = Field(description="every link of the URDF, by name")
    joints: dict[str, NumberOrAxes] = Field(description="positions of the moving joints, by name, metres or radians")


class JointEstimate(BaseModel):
    """A moving joint: metres for slides, radians for turns; planar and floating ones have a list of three or six."""

    type: str = Field(description="revolute, continuous, prismatic, planar or floating")
    position: NumberOrAxes = Field(description="metres or radians")
    std: NumberOrAxes | None = Field(description="the posterior's standard deviation, metres or radians")
    interval: list[float] | list[list[float]] | None = Field(
        description="the central 90 % of the posterior, metres or radians; a pair for each of several axes"
    )
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

    schema_: str = Field(alias="schema", description="name and version of this form", examples=["pmpnbp/estimate-2"])
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
    fit: FitOrNull
    fit_reason: FitReason
    explained: float | None = Field(description="share of what should be seen that the scan confirms, 0 to 1")
    effective_draws: float | None = Field(description="draws of equal weight that would tell as much")
    posterior_iteration: int | None = Field(
        description="the iteration that the posterior was read out from: the first at rest, while the estimate stays"
    )
    links: dict[str, LinkEstimate] = Field(description="every link of the URDF, by name")
    joints: dict[str, JointEstimate] = Field(description="every moving joint, by name")
    alternatives: list[Alternative] = Field(
        description="whole objects that the posterior has weight on, heaviest first; their weights sum to 1"
    )
    unknown: list[str] = Field(description="a sentence for each joint and turn that the scan does not tell at all")
    depth_noise: list[float | None] = Field(
        description="of each scan, metres: standard deviation of its depths at the object, that the inference goes by; "
        "null for one that shows nothing of the region"
    )
    depth_noise_area: list[float | None] = Field(
        description="of each scan, or null: so many pixels of the working image err as one; 1 where each errs alone"
    )
    depth_distortion: list[float | None] = Field(
        description="of each scan, metres: standard deviation at the object of errors that are smooth over all of a "
        "part; 0 where its flat surfaces show none, or null"
    )
    nuisances: dict[str, NuisanceEstimate] = Field(
        description="depth_scale/VIEW, camera/VIEW/AXIS and size/AXIS, where the settings leave them free"
    )
    truth: dict[str, Any] | None = Field(None, description="errors, where the truth is known: ADD in metres by part")
    session_id: str = Field(description="the session")
    state: State = Field(description="what the session was doing when it was asked")
    outdated: bool = Field(description="whether scans or settings have changed since this iteration")


class WeightedPoses(BaseModel):
    """Poses of a link, with weights."""

    session_id: str = Field(description="the session")
    iteration: int = Field(description="the iteration they are of")
    frame_id: str = Field(description="name of the world frame")
    particles: list[list[float]] = Field(description="x y z qw qx qy qz each, metres, link in world")
    log_weights: list[float | None] = Field(
        description="natural logarithms of the weights, which sum to 1; null for a weight of 0"
    )


class PosteriorDraws(WeightedPoses):
    """What the scan leaves open of one link."""

    link: str = Field(description="the link")
    posterior_iteration: int = Field(description="the iteration that the posterior was read out from")
    mode: list[int] = Field(description="of which of the estimate's `alternatives` each draw is, counted from 0")


class DrawnCoordinate(BaseModel):
    """One number of the object in every draw of the posterior."""

    link: str | None = Field(description="the link it is of; null for a joint")
    name: str = Field(
        description="x, y, z, roll, pitch or yaw of the link, or `joint NAME`; `joint NAME/x` and so on where it has "
        "several axes"
    )
    unit: Literal["m", "rad"] = Field(description="metres or radians")
    values: list[float] = Field(
        description="of each draw, in the unit; positions and fixed X, Y, Z of world, angles at most half a turn from "
        "the estimate's"
    )
    estimate: float = Field(description="the estimate's number, in the unit")


class PosteriorCoordinates(BaseModel):
    """What the scan leaves open of the whole object, number by number."""

    session_id: str = Field(description="the session")
    iteration: int = Field(description="the iteration whose estimate the draws are set against")
    posterior_iteration: int = Field(description="the iteration that the posterior was read out from")
    log_weights: list[float | None] = Field(
        description="natural logarithms of the draws' weights, which sum to 1; null for a weight of 0"
    )
    mode: list[int] = Field(description="of which of the estimate's `alternatives` each draw is, counted from 0")
    coordinates: list[DrawnCoordinate] = Field(
        description="every moving joint's, then those of the links that were asked for; draw i of all of them is of "
        "one configuration"
    )


class Particles(WeightedPoses):
    """Poses of the algorithm's particles."""

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
    stage: str = Field(description="start, search, tracking, belief propagation, refine or particle filter")
    seconds: float = Field(description="wall time of the iteration")
    elapsed: float = Field(description="wall time of all so far, with reading them out, seconds")
    tolerance: float = Field(description="distance at which a pixel stops to be explained, metres")
    effective_sample_size: dict[str, float | None] = Field(description="by part, particles")
    log_likelihood: float | None = Field(
        description="log score of the object as a whole, at the iteration's own tolerance; null where there is none"
    )
    final_log_likelihood: float | None = Field(
        None,
        description="sum of the parts' log likelihoods at the estimate, at the final tolerance in every iteration, so "
        "that iterations can be compared; null in older recordings",
    )
    std_xyz: dict[str, list[float]] | None = Field(
        description="by link, the posterior's standard deviations along world's axes, metres; null where there is none"
    )
    particle_std_xyz: dict[str, list[float]] = Field(description="by link, spread of the particles, metres")
    add: dict[str, float] | None = Field(description="by part, metres (eq. 12); null where the truth is not known")
    converged: bool = Field(description="whether the inference had come to rest")
    certain: Certain
    certain_by_link: dict[str, bool] | None = Field(
        None, description="by link, whether it is certain; null where there is no posterior, and in older recordings"
    )
    fit: FitOrNull
    fit_reason: FitReason
    posterior_iteration: int | None = Field(description="the iteration that the posterior was read out from, or null")
    notes: list[str] = Field(description="what the inference had to remark")

    @computed_field(description="whether it searches, settles or is at rest, as a session's `phase`")  # type: ignore[prop-decorator]
    @property
    def phase(self) -> Phase:
        """By stage and rest, whatever a recording from elsewhere says."""
        return phase_of(self.stage, self.converged)


class TraceChange(BaseModel):
    """What was changed on the way: settings, or a view that came."""

    after_iteration: int = Field(description="iterations beyond this one are made with the change")
    config: dict[str, Any] | None = Field(None, description="settings by name, where some were changed")
    scan_id: str | None = Field(
        None, description="id of the scan, where one came; `view N` in an uploaded recording, which knows no ids"
    )
    mode: ScanMode | None = Field(None, description="of that scan: another view of the same scene, or of a changed one")


class Trace(BaseModel):
    """All iterations at a glance."""

    session_id: str = Field(description="the session")
    changes: list[TraceChange] = Field(description="what was changed on the way, in order")
    iterations: list[TraceRow] = Field(description="ascending")


class View(BaseModel):
    """A place to look from."""

    pose: Pose = Field(description="pose_world_camera, optical: x right, y down, z forward")
    cost: float = Field(description="what it takes to get there, as the planner gave it, or 1")
    expected_gain_nats: float = Field(
        description="how much less there is to know of the links, down to max_std, after a scan from there"
    )
    worthwhile: bool = Field(description="whether that is worth a scan: 0.1 nats and more")
    expected_std_xyz: dict[str, list[float]] = Field(description="by link, metres, after such a scan")


class Sight(BaseModel):
    """How much of a link is in sight at the estimate, in the view that sees most of it: shares of the pixels that its
    part would cover alone, which sum to 1."""

    view: int = Field(description="which of the scans, counted from 0")
    seen: float = Field(description="share in sight")
    behind: dict[str, float] = Field(description="share behind other parts of the object, by part, largest first")
    in_front: float = Field(description="share behind something that is not the object")


class Decision(BaseModel):
    """Whether to act on the estimate."""

    session_id: str = Field(description="the session")
    iteration: int = Field(description="the iteration this is decided by")
    outdated: bool = Field(
        description="whether scans or settings have changed since this iteration; one that is asked for by its number "
        "is decided by as it was"
    )
    action: Literal["act", "look", "no_fit"] = Field(
        description="act where all asked links are certain, else look again; no_fit where the fit is not good"
    )
    reason: str = Field(description="why, in a sentence")
    certain: bool = Field(description="whether all asked links are certain")
    max_std: float = Field(description="metres, up to which a link is certain")
    links: list[str] = Field(description="the links that were asked about")
    blocking: list[str] = Field(description="those of them that are not certain")
    sight: dict[str, Sight | None] = Field(
        description="what hides each of those; null where it would cover no pixel: outside all images"
    )
    views: list[View] = Field(description="where to look from next, best first; empty where to act")
