"""Through which camera is a point cloud looked at? Fits one to an organised cloud, makes one up for a loose cloud."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmpnbp.errors import ScanError
from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.reach import WIDEST_RAY

# Points that a fit needs, and is made from at most.
FEWEST, MOST = 20, 60_000
# Largest median distance, pixels, between where a point is stored and where the camera sees it: for a camera fitted
# to the cloud, and for one that was given beside it and may be rounded or leave out the lens distortion.
FITTED_RESIDUAL, GIVEN_RESIDUAL = 0.5, 5.0
# A loose cloud with a camera file is in the world's frame where less than SEEN of it is in the picture as it is, and
# more than ALL_SEEN where it is taken to be in that frame.
SEEN, ALL_SEEN = 0.5, 0.9
# A virtual camera sees 65° to either side at most; beyond, the image plane stretches without end.
WIDEST = 2.14
LARGEST_IMAGE = 2048
# So that few pixels of a surface stay empty (of Poisson scattered points, one in five).
POINTS_PER_PIXEL = 1.5


def fit_camera(points: NDArray[np.floating], viewpoint: Array, name: str) -> tuple[Camera, NDArray[np.floating]]:
    """The camera that took the organised cloud `points` (H, W, 3), and the points in its frame.

    Column = fx x/z + cx and row = fy y/z + cy are fitted by least squares, outliers left out. The points are taken to
    be in the camera frame, and if that does not hold, in that of the cloud's `viewpoint` (7,). Raises ScanError where
    no pinhole camera puts them at their rows and columns.
    """
    frames = [(poses.IDENTITY, points)]
    if not np.array_equal(viewpoint, poses.IDENTITY):
        frames.append((viewpoint, _in_sensor_frame(points, viewpoint)))
    residual = np.inf
    for pose, local in frames:
        intrinsics, residual = _intrinsics(local)
        if intrinsics is not None and residual <= FITTED_RESIDUAL:
            height, width = points.shape[:2]
            camera = Camera(width, height, *intrinsics, pose_world_camera=pose)
            if camera.widest_ray <= WIDEST_RAY:
                return camera, local
    detail = f" (off by {residual:.1f} pixels at the median)" if np.isfinite(residual) else ""
    raise ScanError(
        f"no pinhole camera puts the points of scan '{name}' at their rows and columns{detail}; expected points in the "
        "camera frame, or a camera file"
    )


def check_camera(points: NDArray[np.floating], usable: NDArray[np.bool_], camera: Camera, name: str) -> None:
    """Raise ScanError where `camera` does not see the `usable` ones of the organised `points` (H, W, 3) at their
    pixels: the points are then not in its frame, or it is another camera."""
    rows, columns = np.nonzero(usable)
    if len(rows) == 0:
        return
    seen = camera.project(points[rows, columns].astype(np.float64))
    off = float(np.median(np.hypot(seen[:, 0] - columns, seen[:, 1] - rows)))
    if off > GIVEN_RESIDUAL:
        raise ScanError(
            f"the camera file sees the points of scan '{name}' {off:.1f} pixels from their rows and columns at the "
            "median; expected points in the frame of that camera"
        )


def look_at_loose_cloud(
    points: NDArray[np.floating], viewpoint: Array, camera: Camera | None, name: str
) -> tuple[Camera, NDArray[np.float32]]:
    """A camera and what it sees of the loose cloud `points` (N, 3): depth (height, width), metres, the nearest point
    of each pixel, 0 where there is none.

    Where no `camera` is given it stands at the cloud's `viewpoint` (7,), looks along its z, covers the points, and has
    about as many pixels as it sees points. A given one is binned where its pixels are finer than the points, because
    an image of holes would say that nothing was measured. Raises ScanError where no point is in front of the sensor,
    or in the picture of the camera that was given, or nearly all would be if they were in the world's frame.
    """
    if camera is not None:
        _check_frame(points, camera, name)
    in_front = points if camera is not None else _in_sensor_frame(points, viewpoint)
    local: Array = in_front[in_front[:, 2] > 1e-6].astype(np.float64)
    if len(local) == 0:
        raise ScanError(f"scan '{name}' has no valid point in front of its sensor (z above 0, at most 1 km)")
    camera = _virtual_camera(local, viewpoint, name) if camera is None else _no_finer_than(local, camera, name)
    pixel, within = _pixels(local, camera)
    depth = np.full(camera.width * camera.height, np.inf, dtype=np.float32)
    np.minimum.at(depth, pixel[:, 1] * camera.width + pixel[:, 0], local[within, 2].astype(np.float32))
    depth[np.isinf(depth)] = 0.0
    return camera, depth.reshape(camera.height, camera.width)


def _check_frame(points: NDArray[np.floating], camera: Camera, name: str) -> None:
    """Raise ScanError where few of `points` (N, 3) are in the picture, and most if they are in the world's frame."""
    seen = _in_picture(points, camera)
    if seen >= SEEN * len(points):
        return
    of_world = _in_picture(_in_sensor_frame(points, camera.pose_world_camera), camera)
    if of_world > ALL_SEEN * len(points):
        raise ScanError(
            f"{seen} of the {len(points)} points of scan '{name}' are in the picture of its camera, and {of_world} "
            "would be if they were in the world's frame; expected points in the camera's frame"
        )


def _in_picture(points: NDArray[np.floating], camera: Camera) -> int:
    """How many of `points` (N, 3), camera frame, the camera sees."""
    return int(_pixels(points[points[:, 2] > 1e-6].astype(np.float64), camera)[1].sum())


def _pixels(points: Array, camera: Camera) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Column and row (K, 2) of those of `points` (N, 3), z above 0, that lie in the picture, and which (N,) bool."""
    seen = np.rint(camera.project(points)[:, :2])
    within: NDArray[np.bool_] = np.all((seen >= 0) & (seen < [camera.width, camera.height]), axis=1)
    return seen[within].astype(np.int64), within


def _no_finer_than(points: Array, camera: Camera, name: str) -> Camera:
    """`camera`, binned by the factor that leaves about POINTS_PER_PIXEL of `points` (N, 3) in each pixel they fill."""
    pixel, _ = _pixels(points, camera)
    if len(pixel) == 0:
        raise ScanError(f"no point of scan '{name}' is in the picture of its camera; expected points in its frame")
    factor = round(float(np.sqrt(POINTS_PER_PIXEL / _density(pixel.astype(np.float64)))))
    factor = min(factor, camera.width, camera.height)
    return camera if factor <= 1 else camera.binned(0, 0, factor, camera.width // factor, camera.height // factor)


def _density(places: Array) -> float:
    """Points per unit of area where the points `places` (N, 2) are: the median over them of the density of their cell
    of a coarse grid, so that neither empty space nor a few strays count."""
    # Some thirty points to a cell: with few, the cells that points are in are the fuller ones by chance.
    cells = int(np.clip(np.sqrt(len(places) / 32), 1, 64))
    low = places.min(axis=0)
    span = np.maximum(np.ptp(places, axis=0), 1e-3)
    cell = np.minimum(((places - low) / span * cells).astype(np.int64), cells - 1)
    counts = np.bincount(cell[:, 0] * cells + cell[:, 1], minlength=cells * cells)
    return float(np.median(counts[cell[:, 0] * cells + cell[:, 1]])) / float(span[0] * span[1] / cells**2)


def _in_sensor_frame(points: NDArray[np.floating], viewpoint: Array) -> NDArray[np.floating]:
    if np.array_equal(viewpoint, poses.IDENTITY):
        return points
    matrix = poses.to_matrix(poses.inverse(viewpoint))
    with np.errstate(invalid="ignore", over="ignore"):
        return points @ matrix[:3, :3].T + matrix[:3, 3]


def _intrinsics(points: NDArray[np.floating]) -> tuple[tuple[float, float, float, float] | None, float]:
    """fx, fy, cx, cy of an organised cloud (H, W, 3) in the camera frame, or None, and the median residual, pixels."""
    with np.errstate(invalid="ignore", over="ignore"):
        rows, columns = np.nonzero(np.isfinite(points).all(axis=-1) & (points[..., 2] > 1e-6))
    if len(rows) < FEWEST:
        return None, np.inf
    chosen = np.linspace(0, len(rows) - 1, min(len(rows), MOST)).astype(np.int64)
    rows, columns = rows[chosen], columns[chosen]
    x, y, z = points[rows, columns].astype(np.float64).T
    with np.errstate(over="ignore", invalid="ignore"):
        across = _line(x / z, columns.astype(np.float64))
        down = _line(y / z, rows.astype(np.float64))
    if across is None or down is None:
        return None, np.inf
    (fx, cx, off_across), (fy, cy, off_down) = across, down
    return (fx, fy, cx, cy), max(off_across, off_down)


def _line(slope: Array, pixel: Array) -> tuple[float, float, float] | None:
    """Focal length, centre and median residual of pixel = focal · slope + centre; None where they are not defined."""
    kept = np.isfinite(slope) & (np.abs(slope) < 1e3)
    focal, centre, residual = 0.0, 0.0, np.empty(0)
    for _ in range(4):
        if kept.sum() < FEWEST or np.ptp(pixel[kept]) < 2 or np.std(slope[kept]) < 1e-9:
            return None
        mean_slope, mean_pixel = slope[kept].mean(), pixel[kept].mean()
        deviation = slope[kept] - mean_slope
        focal = float(deviation @ (pixel[kept] - mean_pixel) / (deviation @ deviation))
        centre = float(mean_pixel - focal * mean_slope)
        with np.errstate(invalid="ignore", over="ignore"):
            residual = np.abs(focal * slope + centre - pixel)
        kept = residual <= max(3 * float(np.median(residual[np.isfinite(residual)])), 1e-3)
    if not np.isfinite([focal, centre]).all() or focal < 1e-3:
        return None
    return focal, centre, float(np.median(residual[np.isfinite(residual)]))


def _virtual_camera(points: Array, viewpoint: Array, name: str) -> Camera:
    """A camera at `viewpoint` (7,) that covers `points` (N, 3) of its frame, all with z above 0."""
    slopes = points[:, :2] / points[:, 2:]
    slopes = slopes[(np.abs(slopes) < WIDEST).all(axis=1)]
    if len(slopes) == 0:
        raise ScanError(f"scan '{name}' has no point within 65 degrees of its sensor's z axis")
    low, high = slopes.min(axis=0), slopes.max(axis=0)
    span = np.maximum(high - low, 1e-3)
    focal = float(np.sqrt(_density(slopes) / POINTS_PER_PIXEL))
    focal = min(focal, (LARGEST_IMAGE - 2) / float(span.max()))
    width, height = (int(np.ceil(focal * extent)) + 1 for extent in span)
    return Camera(width, height, focal, focal, -focal * float(low[0]), -focal * float(low[1]), viewpoint)
