"""What is drawn in a 3D view? A list of named nodes, plain arrays: the vocabulary between `frames`, which decides, and
`draw`, which tells viser.

Names are paths. Everything is in metres, in world, or in the frame of the node's pose where it has one, and a node
below another that has a pose is in that one's frame. Colours are sRGB, 0 to 255. An array that is the same object as in
the frame before is not sent again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import IDENTITY, Array
from pmpnbp.pictures.palette import Colour

Floats = NDArray[np.float32]
Bytes = NDArray[np.uint8]
PointShape = Literal["square", "diamond", "circle", "rounded", "sparkle"]


@dataclass(frozen=True)
class Points:
    """points : (P, 3); colours : (P, 3) or (3,); size : of a point, metres; exact : in float32 rather than float16"""

    name: str
    points: Floats
    colours: Bytes
    size: float
    shape: PointShape = "circle"
    exact: bool = True


@dataclass(frozen=True)
class Surface:
    """A mesh at a pose. vertices : (V, 3); faces : (F, 3); opacity : 0 to 1; both_sides : also seen from behind"""

    name: str
    vertices: Floats
    faces: NDArray[np.uint32]
    pose: Array
    colour: Colour
    opacity: float
    both_sides: bool = False


@dataclass(frozen=True)
class Lines:
    """segments : (S, 2, 3), in the frame of `pose`; width : pixels"""

    name: str
    segments: Floats
    colour: Colour
    width: float
    pose: Array = field(default_factory=lambda: IDENTITY)


@dataclass(frozen=True)
class Ellipsoids:
    """centres : (K, 3); turns : (K, 4), w x y z, of the main axes in world; radii : (K, 3) along these;
    colours : (K, 3); opacities : (K,), 0 to 1"""

    name: str
    centres: Floats
    turns: Floats
    radii: Floats
    colours: Bytes
    opacities: Floats


@dataclass(frozen=True)
class Copies:
    """A mesh at several poses. vertices : (V, 3); faces : (F, 3); centres : (K, 3), turns : (K, 4), w x y z, in world;
    colours : (K, 3); opacities : (K,), 0 to 1"""

    name: str
    vertices: Floats
    faces: NDArray[np.uint32]
    centres: Floats
    turns: Floats
    colours: Bytes
    opacities: Floats


@dataclass(frozen=True)
class Axes:
    """Coordinate frames. poses : (K, 7); length : metres"""

    name: str
    poses: Array
    length: float


@dataclass(frozen=True)
class Frustum:
    """A camera. pose : camera in world; field_of_view : radians, from top to bottom; aspect : width over height;
    size : metres; image : (h, w, 3) or None"""

    name: str
    pose: Array
    field_of_view: float
    aspect: float
    size: float
    colour: Colour
    image: Bytes | None


@dataclass(frozen=True)
class Label:
    """A text at the place of `pose`. size : of its letters, which are as large from wherever it is looked at"""

    name: str
    text: str
    size: float = 1.0
    pose: Array = field(default_factory=lambda: IDENTITY)


@dataclass(frozen=True)
class Handle:
    """What can be dragged; `draw` tells who listens by its name. turns : whether it can be turned too"""

    name: str
    pose: Array
    size: float
    turns: bool


Node = Points | Surface | Lines | Ellipsoids | Copies | Axes | Frustum | Label | Handle


@dataclass(frozen=True)
class Targets:
    """What a click can hit. parts : names; particles : (N, T, 3) positions; poses : (N, 7) of the estimate's parts;
    corners : each part's triangles (F, 3, 3) in its own frame; shown : which of the two are drawn"""

    parts: tuple[str, ...]
    particles: Array
    poses: Array
    corners: tuple[Floats, ...]
    particles_shown: bool
    estimate_shown: bool


@dataclass(frozen=True)
class SceneFrame:
    """One picture of the scene. particles : how many of each part are drawn"""

    iteration: int
    nodes: tuple[Node, ...]
    particles: Mapping[str, int]
    targets: Targets
