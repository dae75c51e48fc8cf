"""What sensor and model have wrong everywhere at once: a depth scale per camera, poses of cameras, the object's sizes.

No number of pixels averages such an error out, so it is a parameter with a prior. A part is drawn where and as large as
it appears in a view under given values of these parameters: a linear map, not a rigid motion. The scan stays as it is.

A vector of nuisances has, in this order, K = 7 V + 3 numbers for V views:
    V depth scales: measured depth over true depth, less 1
    6 V camera offsets: of each view's true camera in the frame of the camera that was given, metres and rotation vector
    3 sizes: true size over the model's, less 1, along the root part's axes; poses of parts are those of the resized
        object, see `scene/sizes.py`
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.settings import Settings

# Shares and metres below which a nuisance is fixed: it moves nothing by a micrometre, and a prior as narrow is one that
# no draws are found in.
NEGLIGIBLE = 1e-6
CAMERA_AXES = ("x", "y", "z", "rx", "ry", "rz")


def names(scans: Sequence[int]) -> tuple[str, ...]:
    """(K,) what each nuisance is called, where the views are of the scans numbered so: depth_scale/0, camera/1/rx,
    size/x."""
    return (
        *(f"depth_scale/{scan}" for scan in scans),
        *(f"camera/{scan}/{axis}" for scan in scans for axis in CAMERA_AXES),
        *(f"size/{axis}" for axis in "xyz"),
    )


def levers(distances: Array, lengths: Array) -> Array:
    """(K,): metres that the surface moves for one unit of each, where the object is `distances` (V,) metres from the
    cameras and `lengths` (3,) metres long along the root part's axes."""
    offsets = np.repeat(np.stack([np.ones(len(distances)), distances], axis=1), 3, axis=1)
    return np.concatenate([distances, offsets.ravel(), lengths])


def prior_stds(settings: Settings, levers: Array, views: int) -> Array:
    """(K,) standard deviations about 0 as the settings have them; 0 is fixed, and so is what is NEGLIGIBLE. A camera is
    turned as far as moves the object by `camera_std`; the first is the one that the others are measured against."""
    stds = np.zeros(len(levers))
    scales, offsets, sizes = split(stds, views)
    scales[:] = _free(settings.depth_scale_std)
    offsets[1:] = _free(settings.camera_std) / split(levers, views)[1][1:]
    sizes[:] = _free(settings.size_std)
    return stds


def _free(std: float) -> float:
    return std if std >= NEGLIGIBLE else 0.0


def split(nuisances: Array, views: int) -> tuple[Array, Array, Array]:
    """Depth scales (..., V), camera offsets (..., V, 6) and sizes (..., 3) of vectors (..., K), not copies."""
    offsets = nuisances[..., views : 7 * views].reshape(*nuisances.shape[:-1], views, 6)
    return nuisances[..., :views], offsets, nuisances[..., 7 * views :]


def of_last_views(nuisances: Array, views: int, first: int) -> Array:
    """Those of `views` views, (K,), for the views from number `first` on alone."""
    scales, offsets, sizes = split(nuisances, views)
    return np.concatenate([scales[first:], offsets[first:].ravel(), sizes])


def camera_motion(offset: Array, pose_world_camera: Array) -> Array:
    """(..., 7) by which what is in the world appears to be moved, of a camera's `offset` (..., 6) from where it was
    given, `pose_world_camera` (7,)."""
    true_camera = np.concatenate([offset[..., :3], poses.from_rotation_vector(offset[..., 3:])], axis=-1)
    return poses.multiply(pose_world_camera, poses.inverse(poses.multiply(pose_world_camera, true_camera)))


def apparent(
    nuisances: Array, view: int, views: int, pose_world_camera: Array, poses_world_part: Array, axes_at_zero: Array
) -> Array:
    """Where and how parts appear to be in one of `views` views: maps (..., P, 12) from a part's frame to the world, the
    nine elements of the matrix row by row and then where the part's origin goes.

    nuisances : (..., K); view : its number; pose_world_camera : (7,) as it was given
    poses_world_part : (..., P, 7); axes_at_zero : (P, 3, 3) of these parts, see `Surfaces`
    """
    scales, offsets, sizes = split(nuisances, views)
    moved = camera_motion(offsets[..., view, :], pose_world_camera)
    placed = poses.to_matrix(poses.multiply(moved[..., None, :], poses_world_part))
    scale = (1.0 + scales[..., view])[..., None, None]
    matrix, origin = scale[..., None] * placed[..., :3, :3], placed[..., :3, 3]
    if np.any(sizes):
        matrix = matrix @ (np.eye(3) + np.einsum("pki,...k,pkj->...pij", axes_at_zero, sizes, axes_at_zero))
    origin = pose_world_camera[:3] + scale * (origin - pose_world_camera[:3])
    return np.concatenate([matrix.reshape(*matrix.shape[:-2], 9), origin], axis=-1)
