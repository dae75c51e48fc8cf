"""What sensor and model have wrong everywhere at once: a depth scale per camera, poses of cameras, sizes of parts.

No number of pixels averages such an error out, so it is a parameter with a prior. A part is drawn where and as large as
it appears in a view under given values of these parameters: a similarity, not a rigid motion. The scan stays as it is.

A vector of nuisances has, in this order, for V views and N parts:
    V depth scales: measured depth over true depth, less 1
    6 V camera offsets: of each view's true camera in the frame of the camera that was given, metres and rotation vector
    N sizes: true size over the model's, less 1, about the middle of the part
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.settings import Settings

CAMERA_AXES = ("x", "y", "z", "rx", "ry", "rz")


def names(views: int, parts: Sequence[str]) -> tuple[str, ...]:
    """(K,) what each nuisance is called: depth_scale/0, camera/1/rx, size/drawer1."""
    return (
        *(f"depth_scale/{view}" for view in range(views)),
        *(f"camera/{view}/{axis}" for view in range(views) for axis in CAMERA_AXES),
        *(f"size/{part}" for part in parts),
    )


def levers(distances: Array, radii: Array) -> Array:
    """(K,): metres that the surface moves for one unit of each, where the object is `distances` (V,) metres from the
    cameras and its parts reach `radii` (N,) metres from their middles."""
    offsets = np.repeat(np.stack([np.ones(len(distances)), distances], axis=1), 3, axis=1)
    return np.concatenate([distances, offsets.ravel(), radii])


def prior_stds(settings: Settings, levers: Array, views: int) -> Array:
    """(K,) standard deviations about 0 as the settings have them; 0 is fixed. A camera is turned as far as moves the
    object by `camera_std`; the first camera is the one that the others are measured against."""
    stds = np.zeros(len(levers))
    scales, offsets, sizes = split(stds, views)
    scales[:] = settings.depth_scale_std
    offsets[1:] = settings.camera_std / split(levers, views)[1][1:]
    sizes[:] = settings.size_std
    return stds


def split(nuisances: Array, views: int) -> tuple[Array, Array, Array]:
    """Depth scales (..., V), camera offsets (..., V, 6) and sizes (..., N) of vectors (..., K), not copies."""
    offsets = nuisances[..., views : 7 * views].reshape(*nuisances.shape[:-1], views, 6)
    return nuisances[..., :views], offsets, nuisances[..., 7 * views :]


def of_last_views(nuisances: Array, views: int, first: int) -> Array:
    """Those of `views` views, (K,), for the views from number `first` on alone."""
    scales, offsets, sizes = split(nuisances, views)
    return np.concatenate([scales[first:], offsets[first:].ravel(), sizes])


def apparent(
    nuisances: Array,
    view: int,
    views: int,
    pose_world_camera: Array,
    poses_world_part: Array,
    parts: NDArray[np.integer],
    centres: Array,
) -> Array:
    """Where parts appear to be in one of `views` views: poses (..., P, 7) whose quaternions have the square root of the
    apparent scale as their length.

    nuisances : (..., K); view : its number; pose_world_camera : (7,) as it was given
    poses_world_part : (..., P, 7) of the parts numbered `parts` (P,); centres : (N, 3), the middles of all parts
    """
    scales, offsets, sizes = split(nuisances, views)
    size = sizes[..., parts, None]
    middles = poses.rotate(poses_world_part[..., 3:], centres[parts])
    grown = np.concatenate(
        [poses_world_part[..., :3] - size * middles, np.sqrt(1.0 + size) * poses_world_part[..., 3:]], axis=-1
    )
    offset = offsets[..., view, :]
    true_camera = np.concatenate([offset[..., :3], poses.from_rotation_vector(offset[..., 3:])], axis=-1)
    pose_true_camera_world = poses.inverse(poses.multiply(pose_world_camera, true_camera))
    in_camera = poses.multiply(pose_true_camera_world[..., None, :], grown)
    scale = (1.0 + scales[..., view])[..., None, None]
    in_camera = np.concatenate([scale * in_camera[..., :3], np.sqrt(scale) * in_camera[..., 3:]], axis=-1)
    return poses.multiply(pose_world_camera, in_camera)
