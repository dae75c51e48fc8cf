"""What is said of scans that cannot be views of one scene together?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.errors import ScanError
from pmpnbp.geometry.poses import IDENTITY
from pmpnbp.scene.common_scene import check_views
from pmpnbp.scene.observation import Scan
from tests.scene.box_rooms import camera_at

CAMERA = camera_at([1.2, -1.3, 1.0], [0.3, 0.0, 0.3], width=32, height=24)
SCAN = Scan(CAMERA, np.linspace(1.0, 2.0, 32 * 24, dtype=np.float32).reshape(24, 32))
NOISIER = replace(SCAN, depth=SCAN.depth + np.float32(1e-4))
ELSEWHERE = replace(SCAN, camera=camera_at([1.3, -1.3, 1.0], [0.3, 0.0, 0.3], width=32, height=24))
WITHOUT = replace(NOISIER, camera=replace(CAMERA, pose_world_camera=IDENTITY))


@pytest.mark.parametrize(
    "scans",
    [
        [SCAN],
        [WITHOUT],
        [SCAN, NOISIER],
        [SCAN, ELSEWHERE],
        [WITHOUT, replace(WITHOUT, depth=SCAN.depth)],
        [SCAN, WITHOUT],  # without a pose is at the world's origin
        [SCAN, replace(SCAN, depth=SCAN.depth[:12])],
    ],
)
def test_several_views_are_taken(scans: list[Scan]) -> None:
    check_views(scans)


@pytest.mark.parametrize(
    "again",
    [
        SCAN,
        replace(SCAN, depth=SCAN.depth.copy(), stamp=7.0),
        replace(SCAN, camera=replace(CAMERA, pose_world_camera=CAMERA.pose_world_camera * [1, 1, 1, -1, -1, -1, -1])),
    ],
)
def test_a_view_counts_once(again: Scan) -> None:
    with pytest.raises(
        ScanError, match=r"^scan 3 of 3 is scan 1 again, with the same depths and camera pose; expected"
    ):
        check_views([SCAN, ELSEWHERE, again])
