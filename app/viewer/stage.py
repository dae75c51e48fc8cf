"""What of a scene stays the same from iteration to iteration? The object's shapes, the scan's points, and where to look
from. Made once for an object and its scans; the arrays in here are told apart by identity.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from app.viewer.ruler import Ruler, ruler
from app.viewer.scan_points import ScanPoints
from app.viewer.scene_frame import Bytes, Floats
from app.viewer.view_state import THEMES, Eye, Theme
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.problem import Problem
from pmpnbp.pictures.part_images import CREASE, drawn
from pmpnbp.scene.articulated_object import ArticulatedObject, Part
from pmpnbp.scene.observation import OBJECT, Observation
from pmpnbp.scene.observe import pixel_categories

# A part of more triangles than this is drawn by its inference mesh: every one of them goes to the browser.
MOST_TRIANGLES = 20_000
# The points around the object begin with one pixel of each block, of so many rows and columns: without a graphics card
# no others are drawn while something moves.
BLOCK = (2, 3)
# Half a support plane's square, as a share of the object's size.
SQUARE = 1.2
# Of the lines along a part's edges, the longest.
MOST_LINES = 3000
# The view begins so many times as far from the object as the scan's camera, so much higher, as a share of that, and so
# far round to the side, radians: the camera is seen then, and not in front of the object.
FARTHER, HIGHER, ASIDE = 1.45, 0.3, 0.2


@dataclass(frozen=True)
class Shape:
    """A part's looks, in its own frame. vertices, faces : split along creases, so that flat sides look flat
    edges : (S, 2, 3) where it has a crease or ends; corners : (F, 3, 3) of the inference mesh, for clicks"""

    vertices: Floats
    faces: NDArray[np.uint32]
    edges: Floats
    corners: Floats


@dataclass(frozen=True)
class Cloud:
    """Some points of a scan. which : (P,) their numbers in it; points : (P, 3) world
    depth_colours, plain_colours : (P, 3), for each theme"""

    which: NDArray[np.intp]
    points: Floats
    depth_colours: Mapping[Theme, Bytes]
    plain_colours: Mapping[Theme, Bytes]


@dataclass(frozen=True)
class Stage:
    """problem : whose stage it is; model : its object; shapes : None for a part without geometry
    scans : one per view; categories : (P,) of each scan's points, as `View.category`
    clouds : of each scan what may be the object, and what is around it
    planes : (4, 3) corners of a square in each support plane; ruler : None where nothing may be the object
    up : (3,) world; eye : where the view begins; size : metres, about that of the object"""

    problem: Problem
    model: ArticulatedObject
    shapes: tuple[Shape | None, ...]
    scans: tuple[ScanPoints, ...]
    categories: tuple[NDArray[np.uint8], ...]
    clouds: tuple[tuple[Cloud, Cloud], ...]
    planes: tuple[Floats, ...]
    ruler: Ruler | None
    up: Array
    eye: Eye
    size: float


def stage(problem: Problem, scans: tuple[ScanPoints, ...]) -> Stage:
    """The stage of a problem whose scans these are."""
    model, observation = problem.mrf.model, problem.observation
    categories = tuple(
        pixel_categories(scan.depth[scan.measured], scan.points, observation.roi, observation.planes) for scan in scans
    )
    clouds = tuple(_clouds(scan, category) for scan, category in zip(scans, categories, strict=True))
    eye, size = _eye(observation), object_size(model)
    planes = tuple(_square(plane, np.array(eye.look_at), SQUARE * size) for plane in observation.planes)
    shapes = tuple(_shape(part) if part.visible else None for part in model.parts)
    own = np.concatenate([one.points for one, _ in clouds]) if clouds else np.zeros((0, 3))
    ahead = poses.rotate(observation.views[0].camera.pose_world_camera[3:], np.array([0.0, 0.0, 1.0]))
    measure = ruler(own.astype(np.float64), observation.planes, observation.up, ahead, size)
    return Stage(problem, model, shapes, scans, categories, clouds, planes, measure, observation.up, eye, size)


def object_size(model: ArticulatedObject) -> float:
    """Metres: the diagonal of the largest part's box, which lengths in the scene are shares of."""
    return max(float(np.linalg.norm(np.ptp(part.mesh.vertices, axis=0))) for part in model.parts if part.visible)


def _square(plane: Array, near: Array, reach: float) -> Floats:
    """(4, 3) corners of a square in a plane n·x + d = 0 (4,), `reach` from its middle, which is nearest to `near`."""
    normal, middle = plane[:3], near - (plane[:3] @ near + plane[3]) * plane[:3]
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across *= reach / np.linalg.norm(across)
    down = np.cross(normal, across)
    corners = [middle - across - down, middle + across - down, middle + across + down, middle - across + down]
    return np.array(corners, dtype=np.float32)


def _clouds(scan: ScanPoints, category: NDArray[np.uint8]) -> tuple[Cloud, Cloud]:
    """The points that may be the object, and all others, of those one of each BLOCK first."""
    own, others = np.flatnonzero(category == OBJECT), np.flatnonzero(category != OBJECT)
    first = _one_of_each_block(scan.measured.shape, BLOCK)[scan.measured][others]
    others = np.concatenate([others[first], others[~first]])
    return _cloud(scan, own, scan.depth_colours), _cloud(scan, others, scan.around_colours)


def _cloud(scan: ScanPoints, which: NDArray[np.intp], depth_colours: Mapping[Theme, Bytes]) -> Cloud:
    return Cloud(
        which,
        scan.points[which],
        {theme: depth_colours[theme][which] for theme in THEMES},
        {theme: scan.plain_colours[theme][which] for theme in THEMES},
    )


def _one_of_each_block(shape: tuple[int, ...], block: tuple[int, int]) -> NDArray[np.bool_]:
    """(h, w): of each block of rows and columns of pixels any one. Always the same one would make a pattern that the
    picture's own pixels turn into moiré."""
    (rows, columns), (down, across) = block, np.indices(shape)
    chosen = np.random.default_rng(0).integers(rows * columns, size=(-(-shape[0] // rows), -(-shape[1] // columns)))
    kept: NDArray[np.bool_] = columns * (down % rows) + across % columns == chosen[down // rows, across // columns]
    return kept


def _shape(part: Part) -> Shape:
    mesh = drawn(part) if len(part.mesh.faces) <= MOST_TRIANGLES else part.inference_mesh
    whole = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    whole.merge_vertices(merge_norm=True, merge_tex=True)
    split = trimesh.graph.smooth_shade(whole, angle=CREASE)
    inner = part.inference_mesh
    return Shape(
        np.asarray(split.vertices, dtype=np.float32),
        np.asarray(split.faces, dtype=np.uint32),
        _edges(whole),
        np.asarray(inner.vertices, dtype=np.float32)[np.asarray(inner.faces)],
    )


def _edges(mesh: trimesh.Trimesh) -> Floats:
    creased = np.asarray(mesh.face_adjacency_edges)[np.asarray(mesh.face_adjacency_angles) > CREASE]
    every, count = np.unique(np.asarray(mesh.edges_sorted), axis=0, return_counts=True)
    segments = np.asarray(mesh.vertices)[np.concatenate([creased, every[count == 1]]).reshape(-1, 2)]
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1)
    return segments[np.argsort(-length, kind="stable")[:MOST_LINES]].astype(np.float32)


def _eye(observation: Observation) -> Eye:
    """From a little behind and above the first camera, towards what may be the object."""
    camera = observation.views[0].camera.pose_world_camera
    # ahead of the camera where no point has a normal
    ahead = poses.transform_points(camera, np.array([0.0, 0.0, 1.5]))
    target = np.median(observation.points, axis=0) if len(observation.points) else ahead
    back = camera[:3] - target
    distance = max(float(np.linalg.norm(back)), 1e-3)
    aside = poses.rotate(poses.from_rotation_vector(ASIDE * observation.up), back)
    position = target + FARTHER * aside + HIGHER * distance * observation.up
    return Eye(position=triple(position), look_at=triple(target), up=triple(observation.up))


def triple(vector: Array) -> tuple[float, float, float]:
    """A vector (3,) as a view's state has it."""
    x, y, z = (round(float(value), 6) for value in vector)
    return x, y, z
