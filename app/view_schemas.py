"""What do calls about 3D views take and give? Every member with its unit and frame; /docs is made of this."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from app.schemas import Body, Finite, Members

Point = Annotated[list[Finite], Field(min_length=3, max_length=3)]
_Iteration = Annotated[int, Field(ge=0, le=2**31)]
_PartName = Annotated[str, Field(max_length=200)]


class Layers(Body):
    """Which layers are drawn; those that are not named stay as they are."""

    model_config = ConfigDict(extra="forbid", strict=True)

    scan: bool = Field(True, description="the scan's points")
    camera: bool = Field(True, description="the frustum of each scan's camera")
    image: bool = Field(False, description="the depth image in the frustum")
    particles: bool = Field(True, description="every part's particles, where the part's frame is")
    axes: bool = Field(False, description="the orientations of the selected part's 24 heaviest particles")
    estimate: bool = Field(True, description="the parts where the estimate has them")
    ellipsoids: bool = Field(True, description="the covariance of each part's position, at `confidence`")
    truth: bool = Field(False, description="outlines of the parts where they really are, where that is known")
    planes: bool = Field(False, description="the support planes that were found")
    region: bool = Field(False, description="`region` as a box whose corners can be dragged")
    prior: bool = Field(False, description="`prior` as a frame that can be dragged and turned")
    messages: bool = Field(False, description="the particles of both messages of the selected edge")


class CompareWith(Body):
    """What is laid over the scene."""

    session_id: str = Field(description="id of a session, this one too, or of a recording", max_length=64)
    iteration: _Iteration | None = Field(None, description="number of its iteration; null for its newest")


class ViewCamera(Body):
    """Where the scene is looked at from."""

    position: Point = Field(description="metres in world")
    look_at: Point = Field(description="metres in world: the point that is orbited about")
    up: Point = Field(description="direction in world that is up in the picture")


class DrawnScene(BaseModel):
    """What the 3D view last drew."""

    iteration: int = Field(description="number of the iteration")
    particles: dict[str, int] = Field(description="by part, how many particles; empty where they are not shown")
    serial: int = Field(description="counts what was drawn in this view")


class ViewChange(Body):
    """Members of a view's state to change; `show` is merged too, all else is replaced."""

    iteration: _Iteration | None = Field(
        None, description="number of the iteration to show; null for the newest, whatever that is"
    )
    show: Layers = Field(Layers.model_construct(), description="which layers are drawn")
    colour_scan: Literal["depth", "explained", "plain"] = Field(
        "depth",
        description="of the scan's points: by depth; by how the estimate fits them (explained, occluding, free space "
        "violated, not covered); or one colour",
    )
    colour_particles: Literal["part", "weight"] = Field(
        "part", description="by part; or paler the less a particle weighs beside its part's heaviest"
    )
    confidence: float = Field(
        0.75, description="share of the position's distribution that an ellipsoid holds", gt=0, lt=1, examples=[0.75]
    )
    part: _PartName | None = Field(None, description="name of the selected part", examples=["drawer2"])
    edge: Annotated[list[_PartName], Field(min_length=2, max_length=2)] | None = Field(
        None, description="names of two parts that a joint connects: the selected edge", examples=[["frame", "drawer2"]]
    )
    particle: _Iteration | None = Field(None, description="index of the selected particle of the selected part")
    compare: CompareWith | None = Field(None, description="another session or iteration to lay over this one")
    theme: Literal["light", "dark"] = Field("light", description="the ground that is drawn on")
    camera: ViewCamera | None = Field(None, description="where it is looked at from; null: where a view begins")
    region: Annotated[list[Finite], Field(min_length=6, max_length=6)] | None = Field(
        None, description="x0 y0 z0 x1 y1 z1, metres in world: what the box in the scene says; at first the session's"
    )
    prior: Members | None = Field(
        None, description="gaussian, as prior.json: what the frame in the scene says; at first the session's"
    )
    hidden: bool = Field(False, description="nobody sees the view just now: nothing is drawn")
    economy: bool = Field(
        False,
        description="the browser draws without a graphics card: fewer points around the object, and while the session "
        "runs one picture a second",
    )


class ViewState(ViewChange):
    """What a 3D view shows."""

    drawn: DrawnScene | None = Field(description="null where nothing was drawn yet")
    clients: int = Field(description="browsers that show the scene")
    error: str | None = Field(description="one sentence, where the state cannot be drawn; the scene stays as it was")


def given(change: ViewChange) -> dict[str, Any]:
    """The members that were sent, and of `show` the layers that were."""
    return change.model_dump(exclude_unset=True)
