"""How does a scan stay as it was read? As one `.npz`: depth image and camera, every number with its bits."""

from __future__ import annotations

import json
import zlib
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from pmpnbp.geometry.camera import Camera
from pmpnbp.scene.observation import Scan

_INTRINSICS = ("fx", "fy", "cx", "cy")
# What reading raises where the file is damaged.
UNREADABLE = (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile, zlib.error)


def write_scan(path: Path, scan: Scan) -> None:
    """Write `scan` to the file `path` (ends with .npz): `depth` (H, W) float32, metres, which is a scan file's too."""
    camera = scan.camera
    # text keeps the world frame's name and a stamp that is None; floats in JSON come back with the same bits
    text = json.dumps({"frame_id": scan.frame_id, "stamp": scan.stamp})
    np.savez(
        path,
        depth=scan.depth,
        intrinsics=np.array([getattr(camera, name) for name in _INTRINSICS], dtype=np.float64),
        pose_world_camera=np.asarray(camera.pose_world_camera),
        frame=np.frombuffer(text.encode("utf-8"), dtype=np.uint8),
    )


def read_scan(path: Path) -> Scan:
    """The scan that `write_scan` was given."""
    with np.load(path, allow_pickle=False) as file:
        depth, pose = file["depth"], file["pose_world_camera"]
        numbers = dict(zip(_INTRINSICS, file["intrinsics"].tolist(), strict=True))
        text = json.loads(file["frame"].tobytes().decode("utf-8"))
    depth.setflags(write=False)
    height, width = depth.shape
    camera = Camera(width, height, **numbers, pose_world_camera=pose)
    return Scan(camera, depth, text["frame_id"], text["stamp"])
