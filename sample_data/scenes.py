"""Which scenes can be made by seed? Random cabinets, doors and chains in a room, to measure on what was not tuned on.

`held_out_scene("cabinet", 7)` writes a folder; `random_cabinet(7)` gives the URDF and a builder for further scenes of
the same object. The same kind and seed give the same files.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from sample_data import models, surroundings
from sample_data.rendering import Truth, link_matrices, load, posed, render_scan
from sample_data.scan_folders import write_prior, write_scan

__all__ = [
    "KINDS",
    "Scene",
    "SceneBuilder",
    "Truth",
    "camera_before",
    "held_out_scene",
    "random_cabinet",
    "random_chain",
    "random_door",
    "render_scan",
    "write_scene",
]

Array = NDArray[np.float64]

# A table top's x0 y0 x1 y1, metres, in the frame of what stands on it.
_TABLE = np.array([-0.325, -0.85, 0.425, 0.85])


@dataclass(frozen=True)
class Scene:
    """An object in a room before a camera.

    joint_positions : by name, metres or radians; pose_world_base : (7,) of the URDF's root link
    clutter : everything else, meshes in world; folder : where the URDF's meshes lie, if it has any
    dark : links of which a depth camera sees patches only; sensor : its kind, one of `sensor.KINDS`
    """

    urdf: str
    joint_positions: dict[str, float]
    pose_world_base: Array
    camera: Camera
    clutter: tuple[trimesh.Trimesh, ...]
    folder: Path | None = None
    dark: tuple[str, ...] = ()
    sensor: str = "structured_light"


SceneBuilder = Callable[[np.random.Generator], Scene]


def camera_before(pose_world_base: Array, azimuth: float, distance: float, height: float, aim: float) -> Camera:
    """A camera `azimuth` degrees off the object's front, `distance` metres away on the floor plan and `height` metres
    above the object's foot, that looks at a point `aim` metres above that foot, a little before the object's middle."""
    turn = np.deg2rad(azimuth)
    eye = np.array([distance * np.cos(turn), distance * np.sin(turn), height])
    eye, target = poses.transform_points(pose_world_base, np.array([eye, [0.08, 0.0, aim]]))
    return surroundings.looking_at(eye, target, roll=np.deg2rad(azimuth / 10))


def write_scene(folder: Path, scene: Scene, rng: np.random.Generator) -> Truth:
    """Render `scene` and write depth.png, camera.json, truth.json and roi.json into `folder`."""
    depth, truth = render_scan(
        scene.urdf,
        scene.joint_positions,
        scene.pose_world_base,
        scene.camera,
        scene.clutter,
        rng,
        scene.folder,
        scene.dark,
        scene.sensor,
    )
    write_scan(folder, depth, scene.camera, truth)
    return truth


def _in_room(
    urdf: str, joint_positions: dict[str, float], height: float, table: float, rng: np.random.Generator
) -> Scene:
    """The object on the floor, or on a table `table` metres high, before a wall; `height` is the object's own, metres.

    Cameras are drawn until the whole object is in view, farther and farther away.
    """
    x, y = rng.uniform(-0.8, 0.8, 2)
    pose = surroundings.standing_at(x, y, rng.uniform(-np.pi, np.pi))
    pose[2] = table
    surfaces = posed(urdf, joint_positions, pose)
    for attempt in range(200):
        distance = rng.uniform(1.2, 1.6 + attempt / 100)
        above = rng.uniform(0.9, 1.6) - 0.5 * table
        camera = camera_before(pose, rng.uniform(-38, 38), distance, above, aim=0.45 * height)
        if surroundings.in_view(surfaces, camera):
            break
    else:
        raise ValueError("no camera sees the whole object")
    around = [surroundings.floor()]
    yaw = poses.to_rpy(pose[3:])[2] + np.deg2rad(rng.uniform(-8, 8))
    around.append(surroundings.wall(surfaces, yaw, rng.uniform(0.05, 0.30)))
    if table > 0:
        top = poses.multiply(pose, poses.from_xyz_rpy([0.05, 0.0, -0.02], [0.0, 0.0, 0.0]))
        around.append(surroundings.block(np.array([2 * _TABLE[2] - 0.1, 2 * _TABLE[3], 0.04]), top))
    ground = _TABLE if table > 0 else None
    around += surroundings.clutter(surfaces, pose, int(rng.integers(2, 4)), rng, ground)
    return Scene(urdf, joint_positions, pose, camera, tuple(around))


def random_cabinet(seed: int) -> tuple[str, SceneBuilder]:
    """URDF of a chest of 2 to 4 drawers of random proportions, with or without handles, and its scenes' builder."""
    rng = np.random.default_rng([10, seed])
    count = int(rng.integers(2, 5))
    width, depth = rng.uniform(0.36, 0.60), rng.uniform(0.34, 0.46)
    height = rng.uniform(0.20, 0.25) * count + 0.05
    handle = rng.uniform(0.08, 0.18) if rng.random() < 0.7 else None
    urdf = models.cabinet(width, depth, height, rng.uniform(1.0, 1.6, count).tolist(), handle)
    travel = models.travel(depth)

    def build(rng: np.random.Generator) -> Scene:
        out = np.where(rng.random(count) < 0.3, 0.0, rng.uniform(0.02, travel, count))
        joints = {f"slide{number}": float(slide) for number, slide in enumerate(out, start=1)}
        return _in_room(urdf, joints, height, 0.0, rng)

    return urdf, build


def random_door(seed: int) -> tuple[str, SceneBuilder]:
    """URDF of a cupboard with one or two hinged doors, or of a microwave oven, and its scenes' builder."""
    rng = np.random.default_rng([11, seed])
    side = 1 if rng.random() < 0.5 else -1
    handles = bool(rng.random() < 0.8)
    microwave = bool(rng.random() < 0.4)
    doors = 1 if microwave else int(rng.integers(1, 3))
    if microwave:
        width, depth, height = rng.uniform([0.45, 0.30, 0.26], [0.55, 0.38, 0.33])
        urdf = models.cupboard(width, depth, height, 1, side, rng.uniform(0.08, 0.12), (), handles)
    else:
        width, depth, height = rng.uniform(
            [0.40 + 0.2 * (doors - 1), 0.28, 0.50], [0.55 + 0.25 * (doors - 1), 0.42, 0.85]
        )
        shelves = (0.5,) if rng.random() < 0.6 else (0.35, 0.68)
        urdf = models.cupboard(width, depth, height, doors, side, 0.0, shelves, handles)

    def build(rng: np.random.Generator) -> Scene:
        open_by = np.where(rng.random(doors) < 0.2, 0.0, rng.uniform(0.15, 1.9, doors))
        joints = {f"hinge{number}": float(angle) for number, angle in enumerate(open_by, start=1)}
        return _in_room(urdf, joints, height, rng.uniform(0.55, 0.75) if microwave else 0.0, rng)

    return urdf, build


def _clear(ends: Sequence[Array]) -> bool:
    """Whether a chain whose joints lie at `ends` (K of (3,), in its base's frame) keeps off the floor and itself."""
    points = np.array(ends)
    if np.any(points[2:, 2] < 0.10):
        return False
    share = np.linspace(0.0, 1.0, 8)[:, None]
    segments = [a + share * (b - a) for a, b in pairwise(points)]
    for first in range(len(segments)):
        for second in range(first + 2, len(segments)):
            gap = np.linalg.norm(segments[first][:, None] - segments[second][None], axis=-1).min()
            if gap < 0.12:
                return False
    return True


def random_chain(seed: int) -> tuple[str, SceneBuilder]:
    """URDF of a base with 3 or 4 hinged links, 0.2 to 0.35 m long, like a lamp or an arm, and its scenes' builder."""
    rng = np.random.default_rng([12, seed])
    count = int(rng.integers(3, 5))
    lengths = rng.uniform(0.20, 0.35, count)
    urdf = models.chain(lengths.tolist(), rng.uniform(0.045, 0.08, count).tolist(), bool(rng.random() < 0.5))
    names = [f"hinge{number}" for number in range(1, count + 1)]
    model = load(urdf)

    def build(rng: np.random.Generator) -> Scene:
        for _ in range(1000):
            joints = dict(zip(names, rng.uniform(-1.4, 1.4, count).tolist(), strict=True))
            matrices = link_matrices(model, joints, poses.IDENTITY)
            tip = matrices[f"link{count}"] @ [0.0, 0.0, lengths[-1], 1.0]
            ends = [matrices[f"link{number}"][:3, 3] for number in range(1, count + 1)]
            if _clear([np.zeros(3), *ends, tip[:3]]):
                height = max(end[2] for end in [*ends, tip])
                return _in_room(urdf, joints, height, 0.0, rng)
        raise ValueError("no joint positions keep the chain off the floor and off itself")

    return urdf, build


KINDS: dict[str, Callable[[int], tuple[str, SceneBuilder]]] = {
    "cabinet": random_cabinet,
    "door": random_door,
    "chain": random_chain,
}


def held_out_scene(kind: str, seed: int, parent: Path | None = None, sensor: str = Scene.sensor) -> Path:
    """Write a random scene: model.urdf, depth.png, camera.json, truth.json, roi.json and a rough prior.json (8 cm
    and 8.6 degrees per axis on the root link).

    kind : cabinet, door or chain; parent : where the folder `kind_seed` is made, by default a fresh temporary folder;
    sensor : the kind of the camera, one of `sensor.KINDS`.
    Returns that folder. Raises ValueError for another kind.
    """
    if kind not in KINDS:
        raise ValueError(f"kind {kind!r} is not one of {', '.join(KINDS)}")
    folder = (parent or Path(tempfile.mkdtemp())) / f"{kind}_{seed}"
    urdf, build = KINDS[kind](seed)
    rng = np.random.default_rng([13, list(KINDS).index(kind), seed])
    scene = replace(build(rng), sensor=sensor)
    write_scene(folder, scene, rng)
    (folder / "model.urdf").write_text(urdf)
    write_prior(folder / "prior.json", load(urdf).base_link, scene.pose_world_base, rng)
    return folder
