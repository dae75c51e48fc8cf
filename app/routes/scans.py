"""Scans: depth images and point clouds."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, Field

from app.problems import responses
from app.routes.entries import IF_NONE_MATCH, Stored, created, form, unchanged_or
from app.store.store import Store
from app.uploads.uploads import Uploads

router = APIRouter(prefix="/api/v1", tags=["scans"])


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


@router.post(
    "/scans",
    status_code=201,
    response_model=Scan,
    operation_id="create_scan",
    summary="Upload a scan",
    description="PNG (16 bit, millimetres, needs `camera`), PCD, PLY, XYZ, NPY or NPZ (metres), told by the file "
    "name's suffix. Points are in the camera's optical frame; `world` is that frame where no pose is given.",
    responses=created(Scan) | responses(408, 409, 413, 415, 507),
    openapi_extra=form(
        "the scan; its file name has the suffix png, pcd, ply, xyz, txt, npy or npz",
        camera="text of camera.json: width, height, fx, fy, cx, cy in pixels, T_world_camera (16 numbers, row-major), "
        "frame_id, stamp in seconds",
    ),
)
async def create_scan(request: Request, response: Response) -> Any:
    """Take in the form's parts `file` and `camera`."""
    uploads: Uploads = request.app.state.uploads
    return await uploads.take_in(request, response, "scans")


@router.get(
    "/scans", response_model=list[Scan], operation_id="list_scans", summary="All scans", description="Oldest first."
)
def list_scans(request: Request) -> Any:
    """Every scan's document."""
    store: Store = request.app.state.store
    return store.scans()


@router.get(
    "/scans/{scan_id}",
    response_model=Scan,
    operation_id="get_scan",
    summary="One scan",
    description="Never changes, as its ETag says: ask with If-None-Match.",
    responses=IF_NONE_MATCH | responses(404),
)
def get_scan(scan_id: str, request: Request, response: Response) -> Any:
    """A scan's document, or 304."""
    store: Store = request.app.state.store
    return unchanged_or(request, response, store.scan(scan_id))


@router.delete(
    "/scans/{scan_id}",
    status_code=204,
    operation_id="delete_scan",
    summary="Delete a scan",
    description="Only where no session uses it.",
    responses=responses(404, status_409="A session uses it; the detail names it."),
)
def delete_scan(scan_id: str, request: Request) -> Response:
    """Forget a scan."""
    store: Store = request.app.state.store
    store.delete_scan(scan_id)
    return Response(status_code=204)
