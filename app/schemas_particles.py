"""What do calls about parts, single particles and marginals give? Every member with its unit and frame."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from app.schemas import NumberOrAxes

Colour = Annotated[str, Field(pattern="^#[0-9a-f]{6}$", examples=["#4a72cf"])]
LogNumber = float | None
Source = Literal["start", "own", "neighbour", "surface", "flip"]


class GraphPart(BaseModel):
    """A node of the Markov random field."""

    name: str = Field(description="the part")
    links: list[str] = Field(description="the links that move as this part, its first one first")
    visible: bool = Field(description="whether it has a surface that a scan could show")
    colour: Colour = Field(description="sRGB, where the page is light; the same in 3D, plots and pictures")
    colour_dark: Colour = Field(description="sRGB, where the page is dark")


class GraphJoint(BaseModel):
    """A moving joint."""

    name: str = Field(description="the joint")
    type: str = Field(description="revolute, continuous, prismatic, planar or floating")
    lower: NumberOrAxes = Field(description="limit, metres or radians; a list where it has several axes")
    upper: NumberOrAxes = Field(description="limit, metres or radians; a list where it has several axes")


class GraphEdge(BaseModel):
    """An edge of the Markov random field."""

    parent: str = Field(description="the part it hangs on")
    child: str = Field(description="the part it moves")
    joints: list[GraphJoint] = Field(description="the joints between them, from parent to child; mostly one")


class Graph(BaseModel):
    """The Markov random field of a session's model."""

    session_id: str = Field(description="the session")
    parts: list[GraphPart] = Field(description="nodes, the root first")
    edges: list[GraphEdge] = Field(description="each after the edge that reaches its parent")
    views: int = Field(description="how many scans the newest iteration was made with", ge=0)
    truth: bool = Field(description="whether it is known where the links really are")


class Marginal(BaseModel):
    """A weighted histogram of one number."""

    name: str = Field(
        description="x, y, z, roll, pitch, yaw, or `joint NAME`; `joint NAME/x` and so on where it has several axes"
    )
    unit: Literal["m", "rad"] = Field(description="metres or radians")
    edges: list[float] = Field(description="ends of the bars, one more than bars, ascending, in the unit")
    density: list[float] = Field(
        description="of the belief in each bar, per unit; all but 0.2 % of it lies in the bars"
    )
    estimate: float = Field(description="the estimate's number, in the unit; within the edges")


class Marginals(BaseModel):
    """The belief about a link, one number at a time."""

    session_id: str = Field(description="the session")
    iteration: int = Field(description="the iteration it is of")
    link: str = Field(description="the link")
    part: str = Field(description="the part it moves with")
    marginals: list[Marginal] = Field(
        description="position in world, then roll, pitch and yaw about world's fixed X, Y and Z, counted from the "
        "estimate by at most half a turn, then the joints that the part hangs on"
    )


class Particle(BaseModel):
    """A weighted pose of a link."""

    index: int = Field(description="its number in the belief, 0 for the first", ge=0)
    weight: float = Field(description="its share, 0 to 1; all of a belief's sum to 1")
    log_weight: LogNumber = Field(description="natural logarithm of the weight; null for a weight of 0")
    log_unary: LogNumber = Field(
        description="natural logarithm of the part's unary potential there, before tempering; null where it is 0"
    )
    source: Source = Field(
        description="where it was proposed from: the start, its part's own belief, a neighbour's belief through a "
        "joint, an oriented point of the scan, or a flip of the whole object"
    )
    neighbour: str | None = Field(description="the part whose belief it was proposed from; null for other sources")
    ancestor: int | None = Field(
        description="number of the particle in the iteration before that it descends from: one of `neighbour`'s "
        "where there is one, else of its own part; null where it has none"
    )
    pose: list[float] = Field(description="x y z qw qx qy qz, metres, link in world", min_length=7, max_length=7)


class HeaviestParticles(BaseModel):
    """The best of a belief."""

    session_id: str = Field(description="the session")
    iteration: int = Field(description="the iteration they are of")
    link: str = Field(description="the link")
    part: str = Field(description="the part it moves with")
    count: int = Field(description="how many particles the belief has")
    particles: list[Particle] = Field(description="heaviest first")


class MessageShare(BaseModel):
    """What an incoming message contributes to a particle's log weight."""

    sender: str = Field(alias="from", description="the part that sent it")
    log_share: LogNumber = Field(description="its share, natural logarithm, up to a constant: the sum of its factors")
    log_unary: LogNumber = Field(
        description="its factor from the sender's own unary potential: whether the scan shows the sender where the "
        "joint allows it"
    )
    log_neighbour: LogNumber = Field(description="its factor from the messages of the sender's other neighbours")
    joint_draw: dict[str, float] = Field(
        description="the joint positions at which the sender is explained best, metres or radians, by joint"
    )


class Shares(BaseModel):
    """The terms of a log weight. Natural logarithms."""

    unary: LogNumber = Field(description="the unary potential, tempered: temperature times log_unary")
    prior: LogNumber = Field(
        description="the prior, where it is a factor of this part, or in the particle filter of the object; else 0"
    )
    messages: dict[str, LogNumber] = Field(description="each incoming message's share, by the part that sent it")
    constant: LogNumber = Field(
        description="what is left: the same for all particles of the part, so that weights sum to 1; in the search "
        "also what the score of the object as a whole adds"
    )


class ParticleReasons(Particle):
    """Why a particle weighs what it does, and where it comes from."""

    session_id: str = Field(description="the session")
    iteration: int = Field(description="the iteration it is of")
    stage: str = Field(description="start, search, tracking, belief propagation, refine or particle filter")
    link: str = Field(description="the link that the pose is of")
    part: str = Field(description="the part it moves with")
    origin: str = Field(description="where it comes from, one sentence")
    ancestor_part: str = Field(description="the part whose particle `ancestor` is")
    island: int = Field(description="the hypothesis of the search that it belongs to; 0 where there is one population")
    temperature: float = Field(description="the factor on the log unary potential in this iteration and part")
    log_potential: LogNumber = Field(
        description="log weight before it is normalised: the sum of the shares without the constant"
    )
    shares: Shares = Field(description="log_weight is their sum")
    messages: list[MessageShare] = Field(description="the incoming messages' factors; only belief propagation has any")
    joint_positions: dict[str, NumberOrAxes] | None = Field(
        description="metres or radians by joint, where the particle belongs to a hypothesis of the whole object (in "
        "the search and the particle filter); else null, as a part's particle knows no joint"
    )
