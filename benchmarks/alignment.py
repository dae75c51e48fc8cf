"""Which one rigid motion brings an estimate nearest to the truth? The least-squares fit between paired points.

W. Kabsch, A solution for the best rotation to relate two sets of vectors, Acta Crystallographica A32 (1976).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array


def rigid_fit(points: Array, targets: Array) -> Array:
    """The pose (7,) that takes `points` (n, 3) to `targets` (n, 3) with the smallest sum of squared distances; never a
    reflection."""
    middle, goal = points.mean(axis=0), targets.mean(axis=0)
    left, _, right = np.linalg.svd((points - middle).T @ (targets - goal))
    mirrored = np.sign(np.linalg.det(left @ right))
    rotation = right.T @ np.diag([1.0, 1.0, mirrored]) @ left.T
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, goal - rotation @ middle
    return poses.from_matrix(matrix)


def offset(part_poses: Array, true_poses: Array, points: Sequence[Array]) -> Array:
    """The motion (7,), in world, that brings parts at `part_poses` (N, 7) nearest to `true_poses` (N, 7) all together,
    each part weighing as many times as it has points, N of (m, 3)."""
    found = [poses.transform_points(pose, cloud) for pose, cloud in zip(part_poses, points, strict=True)]
    wanted = [poses.transform_points(pose, cloud) for pose, cloud in zip(true_poses, points, strict=True)]
    return rigid_fit(np.concatenate(found), np.concatenate(wanted))
