"""What does a 3D view show? One value per open view: the page sets it, the scene is drawn from it.

Every member is declared here once, with its default, its bounds or choices, its unit and its meaning; REST's schema,
the validation and the page's controls are made from these declarations. A link to a view carries the state, so
everything in it is plain: names, numbers, and None for "nothing chosen".
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import AfterValidator, ConfigDict, Field, JsonValue, model_validator

from app.schemas import Body, Members
from pmpnbp.errors import PmpnbpError
from pmpnbp.pictures.palette import KIND_COLOURS, KIND_NAMES
from pmpnbp.potentials.pixel_kinds import PixelKind

Theme = Literal["light", "dark"]
Look = Literal["fit", "sensor", "top"]
THEMES: tuple[Theme, ...] = get_args(Theme)

# A scan's points have a depth; one that is not covered is plain.
_NOT_OF_POINTS = PixelKind.NO_DEPTH, PixelKind.GOES_ON
_KINDS_OF_POINTS = (*(kind for kind in KIND_COLOURS if kind not in _NOT_OF_POINTS), PixelKind.NOT_COVERED)
# What the colours of a scan's points mean where they tell how the estimate fits: "" is the plain one.
SCAN_KINDS = tuple((KIND_NAMES[kind], KIND_COLOURS.get(kind, "")) for kind in _KINDS_OF_POINTS)
# Metres: no scene reaches farther.
MAX_COORDINATE = 1e4
_Coordinate = Annotated[float, Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE)]
_Point = Annotated[tuple[_Coordinate, ...], Field(min_length=3, max_length=3)]
_Index = Annotated[int, Field(ge=0, le=2**31)]
_PartName = Annotated[str, Field(max_length=200)]


def _ordered(box: tuple[float, ...]) -> tuple[float, ...]:
    if any(low >= high for low, high in zip(box[:3], box[3:], strict=True)):
        raise ValueError("expected x0 < x1, y0 < y1 and z0 < z1")
    return box


_Box = Annotated[tuple[_Coordinate, ...], Field(min_length=6, max_length=6), AfterValidator(_ordered)]


def _gaussian(prior: dict[str, Any]) -> dict[str, Any]:
    if prior.get("kind") != "gaussian":  # whether it fits the model is asked where the model is known
        raise ValueError("expected a gaussian prior as in prior.json")
    return prior


class ViewStateError(PmpnbpError):
    """A view cannot be shown like this; the text says what came and what was expected."""


def _layer(default: bool, group: str, title: str, description: str, legend: str = "") -> Any:
    """A layer: the page has a switch for it, called `title`, among those of `group`. legend : what its nodes are called
    in the legend; "" for what explains itself"""
    extra: dict[str, JsonValue] = {"group": group, "legend": legend}
    return Field(default=default, title=title, description=description, json_schema_extra=extra)


class Layers(Body):
    """Which layers are drawn; a change leaves those that it does not name as they are."""

    model_config = ConfigDict(frozen=True, strict=True)

    scan: bool = _layer(True, "Scan", "points of the scan", "the scan's points", "the scan")
    camera: bool = _layer(True, "Scan", "camera", "the frustum of each scan's camera", "camera of a scan")
    image: bool = _layer(False, "Scan", "depth image in the camera", "the depth image in the frustum")
    planes: bool = _layer(False, "Scan", "support planes", "the support planes that were found", "support plane")
    ruler: bool = _layer(
        True, "Scan", "ruler", "a ruler at the foot of what may be the object, in metres of the scene", "ruler"
    )
    estimate: bool = _layer(True, "Object", "estimate", "the parts where the estimate has them")
    truth: bool = _layer(
        False, "Object", "truth", "outlines of the parts where they really are, where that is known", "the truth"
    )
    frames: bool = _layer(
        False,
        "Object",
        "axes of the frames",
        "coordinate axes of world, of each scan's camera (optical) and of each part: x red, y green, z blue",
        "axes: x red, y green, z blue",
    )
    ellipsoids: bool = _layer(
        True,
        "Belief",
        "covariance ellipsoids",
        "the posterior's covariance of each part's position, at `confidence`; none before the inference is at rest",
        "covariance ellipsoid, {confidence} inside",
    )
    draws: bool = _layer(
        True,
        "Belief",
        "where else it may be",
        "outlines of uncertain parts where the posterior's draws have them",
        "where else an uncertain part may be",
    )
    next_views: bool = _layer(
        True,
        "Belief",
        "where to look next",
        "cameras from where a scan is expected to tell most of what is not certain, numbered, best first",
        "where to look next, best first",
    )
    particles: bool = _layer(
        True,
        "Algorithm",
        "particles",
        "every part's particles, where the part's frame is: the larger, the heavier; none that weighs nothing",
        "particle, larger where heavier",
    )
    candidates: bool = _layer(
        True,
        "Algorithm",
        "candidates of the search",
        "the objects that the search weighs most, the fainter the lighter",
        "candidate of the search, fainter where lighter",
    )
    particle_ellipsoids: bool = _layer(
        False,
        "Algorithm",
        "ellipsoids of the particles",
        "the covariance of each part's particles, at `confidence`",
        "spread of the particles, {confidence} inside",
    )
    axes: bool = _layer(
        False,
        "Algorithm",
        "axes of the best particles",
        "orientations of the selected part's 24 heaviest particles",
        "axes: x red, y green, z blue",
    )
    messages: bool = _layer(
        False,
        "Algorithm",
        "messages of the chosen edge",
        "the particles of both messages of the selected edge",
        "particle of a message, as its sender",
    )
    region: bool = _layer(
        False, "To drag", "region of interest", "`region` as a box whose corners can be dragged", "region"
    )
    prior: bool = _layer(False, "To drag", "prior", "`prior` as a frame that can be dragged and turned", "prior")


LAYERS = tuple(Layers.model_fields)


class Compare(Body):
    """What is laid over the scene."""

    model_config = ConfigDict(frozen=True)

    session_id: str = Field(description="id of a session, this one too, or of a recording", max_length=64)
    iteration: _Index | None = Field(default=None, description="number of its iteration; null for its newest")


class Eye(Body):
    """Where the scene is looked at from."""

    model_config = ConfigDict(frozen=True)

    position: _Point = Field(description="metres in world")
    look_at: _Point = Field(description="metres in world: the point that is orbited about")
    up: _Point = Field(description="direction in world that is up in the picture")
    field_of_view: float | None = Field(
        default=None, description="radians, from the picture's top to its bottom; null: 36 degrees", ge=0.02, le=2.8
    )

    @model_validator(mode="after")
    def _looks_somewhere(self) -> Self:
        if math.dist(self.position, self.look_at) < 1e-6 or math.hypot(*self.up) < 1e-6:
            raise ValueError("it looks nowhere; expected a position apart from look_at, and a direction up")
        return self


class ViewState(Body):
    """What a 3D view shows. As a change, only the members that were given count: see `merged`."""

    model_config = ConfigDict(frozen=True)

    iteration: _Index | None = Field(
        default=None, description="number of the iteration to show; null for the newest, whatever that is"
    )
    show: Layers = Field(default=Layers(), description="which layers are drawn")
    colour_scan: Literal["depth", "explained", "plain"] = Field(
        default="depth",
        description="of the scan's points: by depth; by how the estimate fits them, as `legend` tells; or one colour",
        json_schema_extra={"legend": [[name, colour] for name, colour in SCAN_KINDS]},
    )
    colour_particles: Literal["part", "weight"] = Field(
        default="part", description="by part; or paler the less a particle weighs beside its part's heaviest"
    )
    confidence: float = Field(
        default=0.75,
        description="share of the position's distribution that an ellipsoid holds",
        gt=0,
        lt=1,
        examples=[0.75],
    )
    part: _PartName | None = Field(default=None, description="name of the selected part", examples=["drawer2"])
    edge: Annotated[tuple[_PartName, ...], Field(min_length=2, max_length=2)] | None = Field(
        default=None,
        description="names of two parts that a joint connects: the selected edge",
        examples=[["frame", "drawer2"]],
    )
    particle: _Index | None = Field(default=None, description="index of the selected particle of the selected part")
    next_view: _Index | None = Field(
        default=None, description="number of the next view that is emphasised, 0 the best; null for the best"
    )
    compare: Compare | None = Field(default=None, description="another session or iteration to lay over this one")
    theme: Theme = Field(default="light", description="the ground that is drawn on")
    camera: Eye | None = Field(default=None, description="where it is looked at from; null: where a view begins")
    look: Look | None = Field(
        default=None,
        description="a place to look from by its name, which sets `camera`: `fit` has the region, where it is shown, "
        "or else the estimate fill the picture; `sensor` looks from the first scan's camera with its field of view; "
        "`top` from above, away from the sensor up in the picture. null again once `camera` is another",
    )
    region: _Box | None = Field(
        default=None,
        description="x0 y0 z0 x1 y1 z1, metres in world: what the box in the scene says; at first the session's",
    )
    proposals: Annotated[tuple[_Box, ...], Field(max_length=20)] = Field(
        default=(),
        description="boxes as `region` that are offered for it, numbered from 1 in the scene; a click on one makes it "
        "the region",
    )
    prior: Annotated[Members, AfterValidator(_gaussian)] | None = Field(
        default=None, description="gaussian, as prior.json: what the frame in the scene says; at first the session's"
    )
    hidden: bool = Field(default=False, description="nobody sees the view just now: nothing is drawn")
    economy: bool = Field(
        default=False,
        description="the browser draws without a graphics card: fewer points around the object, and while the session "
        "runs one picture a second",
    )


def merged(state: ViewState, change: ViewState) -> ViewState:
    """The state with the members that `change` was given in place of its own; of `show` the layers that were.

    Another part forgets the particle, unless one is given too. Raises ViewStateError.
    """
    given = {name: getattr(change, name) for name in change.model_fields_set}
    if "show" in given:
        layers = {layer: getattr(change.show, layer) for layer in change.show.model_fields_set}
        given["show"] = state.show.model_copy(update=layers)
    if "camera" in given:
        given.setdefault("look", None)
    if given.get("part", state.part) != state.part:
        given.setdefault("particle", None)
    new = state.model_copy(update=given)
    if new.particle is not None and new.part is None:
        raise ViewStateError(f"particle {new.particle} is of no part; expected a 'part' with it")
    return new
