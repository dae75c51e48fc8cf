"""What REST shows of a model, of a scan, and of where the one may stand in the other, read from their files.

A file that somebody sends is read so in a process of its own, by `parse_worker`; one of the sample data by the server.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from app.store.stored_scan import UNREADABLE, write_scan
from app.store.stored_scan import read_scan as read_stored_scan
from pmpnbp.errors import ScanError
from pmpnbp.geometry import poses
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.regions import propose_regions
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.scene.urdf import load_model

Summary = dict[str, Any]


def read_model(path: Path) -> Summary:
    """Links, joints and parts of the model in the file `path`. Raises PmpnbpError."""
    model = load_model(path)
    joints = [
        {
            "name": joint.name,
            "type": joint.kind,
            "parent": joint.parent,
            "child": joint.child,
            "lower": None if joint.kind == "fixed" else joint.lower,
            "upper": None if joint.kind == "fixed" else joint.upper,
            "mimic": joint.mimic,
        }
        for joint in model.joints
    ]
    parts = [{"name": part.name, "links": list(part.links)} for part in model.parts]
    return {"name": model.name, "links": list(model.links), "joints": joints, "parts": parts}


def read_scan(path: Path, camera_path: Path | None, out: Path) -> Summary:
    """Camera, and number and bounds of the points in world (metres), of the scan in the file `path`, which is written
    to `out` as the server keeps it. camera_path : of its camera, where the scan does not tell it. Raises PmpnbpError.
    """
    scan = load_scan(path, camera_path)
    camera, valid = scan.camera, scan.depth > 0
    points = camera.back_project(scan.depth)[valid].astype(np.float64)
    points = poses.transform_points(camera.pose_world_camera, points)
    write_scan(out, scan)
    return {
        "points": int(valid.sum()),
        "valid_fraction": float(valid.mean()),
        "camera": {
            "width": camera.width,
            "height": camera.height,
            "fx": float(camera.fx),
            "fy": float(camera.fy),
            "cx": float(camera.cx),
            "cy": float(camera.cy),
            "T_world_camera": poses.to_matrix(camera.pose_world_camera).reshape(-1).tolist(),
            "frame_id": scan.frame_id,
            "stamp": scan.stamp,
        },
        "bounds": [*points.min(axis=0).tolist(), *points.max(axis=0).tolist()],
    }


def read_regions(model: Path, scans: Sequence[Path]) -> Summary:
    """The regions of the model in a file and of scans as the server keeps them. Raises PmpnbpError."""
    found = load_model(model)
    try:
        loaded = [read_stored_scan(path) for path in scans]
    except UNREADABLE:
        raise ScanError("a scan is damaged: what the server keeps of it cannot be read") from None
    return regions(loaded, found)


def regions(scans: Sequence[Scan], model: ArticulatedObject) -> Summary:
    """What `propose_regions` finds, as REST has it. Raises ScanError."""
    return {
        "regions": [
            {
                "roi": one.roi.round(4).tolist(),
                "size": one.size.round(4).tolist(),
                "points": one.points,
                "unlikeness": one.unlikeness,
            }
            for one in propose_regions(scans, model)
        ]
    }
