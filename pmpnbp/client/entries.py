"""What does a server have? Models and scans, as they were taken in, and where the ones may stand in the others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmpnbp.scene.region import Region


@dataclass(frozen=True)
class Joint:
    """A joint of a URDF.

    type : fixed, revolute, continuous, prismatic, planar or floating; parent, child : names of links
    lower, upper : metres (prismatic, planar, floating) or radians; None where fixed
    mimic : name of the joint that it follows, or None
    """

    name: str
    type: str
    parent: str
    child: str
    lower: float | None
    upper: float | None
    mimic: str | None


@dataclass(frozen=True)
class Part:
    """Links that are fixed to each other and move as one, which is what the inference estimates."""

    name: str
    links: tuple[str, ...]


@dataclass(frozen=True)
class Model:
    """A model on a server. links, joints : from the root down, fixed joints too; file_name : as it was uploaded"""

    id: str
    name: str
    links: tuple[str, ...]
    joints: tuple[Joint, ...]
    parts: tuple[Part, ...]
    file_name: str

    @staticmethod
    def from_dict(members: Mapping[str, Any]) -> Model:
        """As REST has it. Raises KeyError or TypeError where it is none."""
        joints = ("name", "type", "parent", "child", "lower", "upper", "mimic")
        return Model(
            id=members["id"],
            name=members["name"],
            links=tuple(members["links"]),
            joints=tuple(Joint(**{name: joint[name] for name in joints}) for joint in members["joints"]),
            parts=tuple(Part(part["name"], tuple(part["links"])) for part in members["parts"]),
            file_name=members["file_name"],
        )


@dataclass(frozen=True, eq=False)
class Camera:
    """The pinhole camera of a scan: given, fitted to an organised cloud, or virtual.

    width, height, fx, fy, cx, cy : pixels, the principal point from the first pixel's centre
    T_world_camera : (4, 4), metres, takes the optical frame (x right, y down, z forward) to world
    frame_id : name of the world frame; stamp : seconds, or None
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    T_world_camera: NDArray[np.float64]
    frame_id: str
    stamp: float | None


@dataclass(frozen=True, eq=False)
class Scan:
    """A scan on a server.

    points : how many pixels have a depth; valid_fraction : their share, 0 to 1
    bounds : (6,) x0 y0 z0 x1 y1 z1, metres in world, the box around the points; may serve as a session's `roi`
    file_name : as it was uploaded
    """

    id: str
    points: int
    valid_fraction: float
    camera: Camera
    bounds: NDArray[np.float64]
    file_name: str

    @staticmethod
    def from_dict(members: Mapping[str, Any]) -> Scan:
        """As REST has it. Raises KeyError, TypeError or ValueError where it is none."""
        camera = members["camera"]
        same = ("width", "height", "fx", "fy", "cx", "cy", "frame_id", "stamp")
        matrix = np.array(camera["T_world_camera"], dtype=np.float64).reshape(4, 4)
        return Scan(
            id=members["id"],
            points=members["points"],
            valid_fraction=members["valid_fraction"],
            camera=Camera(**{name: camera[name] for name in same}, T_world_camera=matrix),
            bounds=np.array(members["bounds"], dtype=np.float64),
            file_name=members["file_name"],
        )


def regions_of(members: Mapping[str, Any]) -> list[Region]:
    """As REST has them. Raises KeyError or TypeError where there are none."""
    return [
        Region(roi=np.array(one["roi"]), size=np.array(one["size"]), points=one["points"], unlikeness=one["unlikeness"])
        for one in members["regions"]
    ]
