"""Can scans be views of one scene? They share a world frame, each tells where its camera stood, none comes twice."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from pmpnbp.errors import ScanError
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import IDENTITY
from pmpnbp.scene.observation import Scan


def common_frame(scans: Sequence[Scan]) -> str:
    """The name of the scans' world frame. Raises ScanError where there is no scan, or their world frames differ."""
    if not scans:
        raise ScanError("no scan was given; expected at least one")
    return one_frame(scan.frame_id for scan in scans)


def one_frame(names: Iterable[str]) -> str:
    """The world frame that all `names` are. Raises ScanError where they differ."""
    frames = sorted(set(names))
    if len(frames) > 1:
        raise ScanError(f"the scans are in different world frames, {', '.join(frames)}; expected one frame for all")
    return frames[0]


def has_pose(scans: Sequence[Scan]) -> bool:
    """Whether a scan says where its camera is, so that world's z is up."""
    return any(not np.array_equal(scan.camera.pose_world_camera, IDENTITY) for scan in scans)


def check_views(scans: Sequence[Scan]) -> None:
    """Raise ScanError where scans that count together cannot: there is none, their world frames differ, or one is given
    twice. Two scans from one place are two: each has its own noise."""
    common_frame(scans)
    for second, scan in enumerate(scans):
        for first, other in enumerate(scans[:second]):
            if _same_view(other, scan):
                raise ScanError(
                    f"scan {second + 1} of {len(scans)} is scan {first + 1} again, with the same depths and camera "
                    "pose; expected each view once, as one that counts twice makes the estimate surer than it is"
                )


def _same_view(one: Scan, other: Scan) -> bool:
    # as matrices, because q and -q are one rotation
    first, second = (poses.to_matrix(scan.camera.pose_world_camera) for scan in (one, other))
    return np.array_equal(first, second) and np.array_equal(one.depth, other.depth)
