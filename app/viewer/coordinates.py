"""What tells where and how large things are? The ruler, and on request the axes of every frame."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from app.viewer.emphasis import INK
from app.viewer.scene_frame import Axes, Label, Lines, Node
from app.viewer.stage import Stage
from app.viewer.view_state import ViewState
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array

# Of an axis, as a share of the object's size; of the letters beside it.
_AXIS, _LETTERS = 0.16, 0.8


def coordinates(stage: Stage, state: ViewState, part_poses: Array) -> Iterator[Node]:
    """The nodes of both, where they are shown. part_poses : (N, 7), part in world"""
    if state.show.ruler and stage.ruler is not None:
        yield Lines("/ruler/marks", stage.ruler.segments, INK[state.theme], 1.5)
        yield Label("/ruler/length", stage.ruler.text, _LETTERS, np.concatenate([stage.ruler.end, poses.IDENTITY[3:]]))
    if state.show.frames:
        cameras = [scan.camera.pose_world_camera for scan in stage.scans]
        placed = np.stack([poses.IDENTITY, *cameras, *part_poses])
        names = ["world", *_camera_names(len(cameras)), *(part.name for part in stage.model.parts)]
        yield Axes("/frames/axes", placed, _AXIS * stage.size)
        for number, (name, pose) in enumerate(zip(names, placed, strict=True)):
            yield Label(f"/frames/{number}", name, _LETTERS, pose)


def _camera_names(count: int) -> list[str]:
    return ["camera"] if count == 1 else [f"camera {number + 1}" for number in range(count)]
