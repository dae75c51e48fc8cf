"""Scans: depth images and point clouds."""

from __future__ import annotations

from pydantic import BaseModel, Field

from app.routes.entries import Stored, add_deletion, entry_routes, form


class ScanCamera(BaseModel):
    """The pinhole camera of a scan, as camera.json has it: given, fitted to an organised cloud, or virtual."""

    width: int = Field(description="pixels", examples=[640])
    height: int = Field(description="pixels", examples=[480])
    fx: float = Field(description="focal length, pixels", examples=[525.0])
    fy: float = Field(description="focal length, pixels", examples=[525.0])
    cx: float = Field(description="principal point, pixels from the first pixel's centre", examples=[319.5])
    cy: float = Field(description="principal point, pixels from the first pixel's centre", examples=[239.5])
    T_world_camera: list[float] = Field(
        description="4x4 row-major, metres: takes the optical frame (x right, y down, z forward) to world",
        min_length=16,
        max_length=16,
    )
    frame_id: str = Field(description="name of the world frame", examples=["world"])
    stamp: float | None = Field(description="seconds, or null")


class Scan(Stored):
    """A scan, ready for sessions."""

    points: int = Field(description="pixels with a depth", examples=[300873])
    valid_fraction: float = Field(description="their share of all pixels, 0 to 1", examples=[0.98])
    camera: ScanCamera
    bounds: list[float] = Field(
        description="box around the points, x0 y0 z0 x1 y1 z1, metres in world; may serve as a session's roi",
        min_length=6,
        max_length=6,
    )


router = entry_routes(
    "scans",
    Scan,
    "PNG (16 bit, millimetres, needs `camera`), PCD, PLY, XYZ, NPY or NPZ (metres), told by the file name's suffix. "
    "Points are in the camera's optical frame; `world` is that frame where no pose is given.",
    form(
        "the scan; its file name has the suffix png, pcd, ply, xyz, txt, npy or npz",
        camera="text of camera.json: width, height, fx, fy, cx, cy in pixels, T_world_camera (16 numbers, row-major), "
        "frame_id, stamp in seconds",
    ),
)
add_deletion(router, "scans")
