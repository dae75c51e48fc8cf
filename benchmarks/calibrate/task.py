"""What is calibrated? A model, a camera, a region and a prior: all that a run needs, on whichever machine it is made.

Where no camera is given, one is put up that has the region in its picture; where no region is, one is laid out that the
object has room in, where the camera looks.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import cached_property, lru_cache
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pmpnbp.errors import ScanError
from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import problem as problems
from pmpnbp.inference.initialisation import prior_roots, random_joints
from pmpnbp.inference.problem import Problem
from pmpnbp.recording.inputs import model_zip
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.camera_file import load_camera
from pmpnbp.scene.observation import Observation
from pmpnbp.scene.prior import GaussianPrior, UniformPrior, load_prior
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import SENSORS, SessionOptions, Settings
from sample_data.surroundings import looking_at

# Draws of the object by which room is laid out, and by how much the region is larger than the largest of them, in its
# size; around draws of a gaussian prior, metres.
SIZED_BY, ROOM, MARGIN = 100, 0.25, 0.10
# Degrees off the region's +x, and above its middle, at which a camera is put up; how far off, in half diagonals of the
# region: its corners are cut off, as nothing but the object's are there.
AZIMUTH, ELEVATION, DISTANCE = 30.0, 30.0, 1.9


@dataclass(frozen=True, kw_only=True)
class Task:
    """archive : the model as a zip, `name` the file's; region : (6,) x0 y0 z0 x1 y1 z1, metres, world; sensor : the
    camera's kind, one of `sample_data.sensor.KINDS`; the rest as `pmpnbp estimate` has it."""

    archive: bytes
    name: str
    camera: Camera
    region: Array
    prior: UniformPrior | GaussianPrior
    settings: Settings
    particles: int = SessionOptions.particles
    iterations: int = SessionOptions.iterations
    max_std: float = SessionOptions.max_std
    sensor: str = SENSORS[0]

    @property
    def model(self) -> ArticulatedObject:
        """As it is in the archive."""
        return _model(self.archive, self.name, self.settings.triangles)

    @property
    def up(self) -> Array:
        """(3,) away from the ground, as the inference takes it."""
        return up_of(self.camera)

    @cached_property
    def digest(self) -> str:
        """What changes with any of it, so that runs of another task are not taken for runs of this one."""
        prior = self.prior if isinstance(self.prior, UniformPrior) else asdict(self.prior)
        numbers = [self.settings, self.particles, self.iterations, self.max_std, prior, self.sensor]
        camera = asdict(self.camera)
        text = json.dumps([str(numbers), {name: np.asarray(value).tolist() for name, value in camera.items()}])
        return sha256(self.archive + text.encode() + self.region.tobytes()).hexdigest()[:16]


def task_of(
    model_file: Path,
    camera_file: Path | None,
    region: Array | None,
    prior_file: Path | None,
    settings: Settings,
    *,
    particles: int = SessionOptions.particles,
    iterations: int = SessionOptions.iterations,
    max_std: float = SessionOptions.max_std,
    sensor: str = SENSORS[0],
) -> Task:
    """The task that files and options make. Raises PmpnbpError where they make none."""
    model = load_model(model_file, triangle_budget=settings.triangles)
    prior = UniformPrior("upright") if prior_file is None else load_prior(prior_file, model)
    camera = None if camera_file is None else load_camera(camera_file).camera
    if region is None:
        up = np.array([0.0, 0.0, 1.0]) if camera is None else up_of(camera)
        problem = unseen(model, prior, settings, up)
        region = _around_prior(problem) if isinstance(prior, GaussianPrior) else _with_room(problem, camera)
    elif np.any(region[:3] >= region[3:]):
        raise ScanError(f"the region {region.tolist()} is empty; expected x0 < x1, y0 < y1 and z0 < z1")
    return Task(
        archive=model_zip(model_file),
        name=model_file.stem,
        camera=camera or _put_up(region),
        region=region,
        prior=prior,
        settings=settings,
        particles=particles,
        iterations=iterations,
        max_std=max_std,
        sensor=sensor,
    )


def unseen(
    model: ArticulatedObject, prior: UniformPrior | GaussianPrior, settings: Settings, up: Array, seed: int = 0
) -> Problem:
    """What the inference knows before there is a scan: its prior can be drawn from."""
    # one point, for no object is looked for where nothing was measured
    nothing = Observation((), np.zeros((1, 3)), up[None], np.zeros((0, 4)), up, None)
    return problems.build(model, nothing, prior, settings, particles=2, seed=seed)


def up_of(camera: Camera) -> Array:
    """(3,) world's z, or without a camera pose the picture's upward direction, as `scene.observe` presumes."""
    posed = not np.array_equal(camera.pose_world_camera, poses.IDENTITY)
    return np.array([0.0, 0.0, 1.0] if posed else [0.0, -1.0, 0.0])


def vertices(model: ArticulatedObject, part_poses: Array) -> Array:
    """(..., V, 3) of all surfaces as the inference has them, with the parts at (..., N, 7)."""
    return np.concatenate(
        [
            poses.transform_points(part_poses[..., node, None, :], part.inference_mesh.vertices)
            for node, part in enumerate(model.parts)
        ],
        axis=-2,
    )


@lru_cache(maxsize=4)
def _model(archive: bytes, name: str, triangles: int) -> ArticulatedObject:
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.zip"
        path.write_bytes(archive)
        return load_model(path, triangle_budget=triangles)


def _around_prior(problem: Problem) -> Array:
    """(6,) a box around draws of a gaussian prior."""
    rng = np.random.default_rng(0)
    joints = random_joints(rng, problem, SIZED_BY)
    model = problem.mrf.model
    corners = vertices(model, model.part_poses(prior_roots(rng, problem, joints), joints))
    return np.concatenate([corners.min(axis=(0, 1)) - MARGIN, corners.max(axis=(0, 1)) + MARGIN])


def _with_room(problem: Problem, camera: Camera | None) -> Array:
    """(6,) a box that the object has room in whichever way it stands: on the ground at the world's origin, or in the
    middle of a given camera's picture, as near as it fits in."""
    model, up = problem.mrf.model, problem.observation.up
    joints = random_joints(np.random.default_rng(0), problem, SIZED_BY)
    corners = vertices(model, model.part_poses(poses.IDENTITY, joints))
    sides = np.ptp(corners, axis=1)
    reach = float(np.hypot(sides[:, 0], sides[:, 1]).max())
    height = float(sides[:, 2].max())
    if problem.any_orientation:
        reach = height = float(np.linalg.norm(sides, axis=1).max())
    size = (1 + ROOM) * np.where(np.abs(up) > 0.5, height, reach)
    if camera is None:
        middle = np.array([0.0, 0.0, size[2] / 2])
    else:
        narrower = min(camera.width / camera.fx, camera.height / camera.fy) / 2
        away = float(np.linalg.norm(size)) / 2 / np.sin(np.arctan(narrower))
        middle = poses.transform_points(camera.pose_world_camera, np.array([0.0, 0.0, away]))
    return np.concatenate([middle - size / 2, middle + size / 2])


def _put_up(region: Array) -> Camera:
    """A camera that looks at the region's middle, from before it and above."""
    middle, half = (region[:3] + region[3:]) / 2, float(np.linalg.norm(region[3:] - region[:3])) / 2
    azimuth, elevation = np.radians([AZIMUTH, ELEVATION])
    across = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])
    return looking_at(middle + DISTANCE * half * np.array([*across, np.sin(elevation)]), middle)
