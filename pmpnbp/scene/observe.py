"""What can the object be matched against? Turns scans into the Observation that the potentials read.

Each scan is brought to a working size (`work_image`). Each of its pixels is told apart: on a support plane, outside the
region, or possibly the object. Planes are found in all views together. What the object can be matched against is less
still once the object is known: a smooth surface longer than it goes on where it ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pmpnbp.errors import ScanError
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.common_scene import common_frame, has_pose
from pmpnbp.scene.depth_distortion import depth_distortion
from pmpnbp.scene.flying_pixels import without_flying_pixels
from pmpnbp.scene.normals import surface_normals
from pmpnbp.scene.observation import (
    CONTINUED,
    NO_DEPTH,
    OBJECT,
    OUTSIDE,
    SUPPORT,
    Observation,
    Scan,
    View,
    points_in_world,
)
from pmpnbp.scene.patches import patch_lengths
from pmpnbp.scene.support_planes import ScenePoints, find_support_planes, flat_surfaces
from pmpnbp.scene.units_check import check_units
from pmpnbp.scene.work_image import WorkImage, work_image

# Pixels of the work image kept around the region's points; of a small image not more than one in so many of its width,
# which has so many at least.
MARGIN, MARGIN_SHARE, LEAST_WIDTH = 15, 8, 40
# Width in pixels of the thinned image that planes are looked for in.
PLANE_WIDTH = 160
# A pixel is on a support plane where it is within so many metres of it, plus so many per metre of depth squared.
PLANE_TOLERANCE, PLANE_TOLERANCE_GROWTH = 0.01, 0.002
# A plane is a wall where its normal is this near to level (cosine of 45°), and a patch parallel to it where its mean
# normal turns less from the wall's (cosine of 18°); metres from which on it stands before the wall.
UPRIGHT, PARALLEL, FLUSH = 0.707, 0.95, 0.02
# A floor leans less than this against the picture's vertical where no camera pose says where up is (cosine of 60°).
FLOOR_COSINE = 0.5


def observe(
    scans: Sequence[Scan],
    roi: Array | None = None,
    *,
    width: int = 160,
    length: float = np.inf,
    up: Array | None = None,
    plane_tolerance: float = PLANE_TOLERANCE,
    plane_tolerance_growth: float = PLANE_TOLERANCE_GROWTH,
) -> Observation:
    """The Observation of one scene in one or several `scans`, which share a world frame.

    roi : (6,) x0 y0 z0 x1 y1 z1, metres, world: the box that holds the object; None for everything that was seen
    width : pixels, the most that the region and its margin have across or down in the work image, see `work_image`
    length : metres, of the object looked for, see `extent.length_of`; a region that is much longer has finer pixels
    up : (3,) world, away from the ground; where it is not given: the world's z where a scan has a camera pose, else the
        normal of the plane that looks like a floor, else the picture's upward direction
    plane_tolerance, plane_tolerance_growth : metres, and metres per metre of depth squared: a pixel is on a support
        plane where it is within tolerance + growth z² of it

    Raises ScanError where there is no scan, the scans' world frames differ, an object of that length can hardly be in
    them, the region is not a box, or no measured point lies in it.
    """
    frame = common_frame(scans)
    if width < LEAST_WIDTH:
        raise ScanError(f"the work image's width is {width}; expected at least {LEAST_WIDTH} pixels")
    roi = None if roi is None else _checked_roi(roi)
    margin = 0 if roi is None else min(MARGIN, width // MARGIN_SHARE)
    scans = [replace(scan, depth=without_flying_pixels(scan.depth)) for scan in scans]
    check_units(length, scans)
    images = [work_image(scan, _in_region(scan, roi), width, margin, length) for scan in scans]
    if all(image is None for image in images):
        raise ScanError(_nothing_in(scans, roi))
    scene = scene_points(scans, roi, plane_tolerance, plane_tolerance_growth)
    above = presumed_up(scans, up)
    flat = flat_surfaces(scene)
    planes = find_support_planes(scene, flat, above, up_is_known=up is not None or has_pose(scans))
    upright = np.abs(planes[:, :3] @ above) < UPRIGHT
    views, points, normals = [], [], []
    surfaces = np.array([plane for plane, _ in flat]).reshape(-1, 4)
    for scan, image in zip(scans, images, strict=True):
        if image is None:  # this scan does not see the region
            continue
        distortion = depth_distortion(scan.camera, scan.depth, surfaces, plane_tolerance, plane_tolerance_growth)
        view = _view(image, distortion, roi, planes, upright, plane_tolerance, plane_tolerance_growth)
        view_points, view_normals = _oriented_points(view)
        views.append(view)
        points.append(view_points)
        normals.append(view_normals)
    stamps = [scan.stamp for scan in scans if scan.stamp is not None]
    return Observation(
        tuple(views),
        np.concatenate(points),
        np.concatenate(normals),
        planes,
        up_direction(scans, planes, up),
        roi,
        frame,
        max(stamps, default=None),
        None if len(views) == len(scans) else tuple(image is not None for image in images),
    )


def _checked_roi(roi: Array) -> Array:
    box = np.array(roi, dtype=np.float64)
    if box.shape != (6,) or not np.isfinite(box).all():
        raise ScanError(f"the region is {np.asarray(roi).tolist()!r:.120}; expected six numbers x0 y0 z0 x1 y1 z1")
    if np.any(box[:3] >= box[3:]):
        raise ScanError(f"the region {box.tolist()} is empty; expected x0 < x1, y0 < y1 and z0 < z1")
    return box


def _nothing_in(scans: Sequence[Scan], roi: Array | None) -> str:
    corners = [points_in_world(scan.camera, scan.depth)[scan.depth > 0] for scan in scans]
    low = np.min([points.min(axis=0) for points in corners], axis=0).round(3)
    high = np.max([points.max(axis=0) for points in corners], axis=0).round(3)
    box = None if roi is None else roi.tolist()
    return f"no measured point lies in the region {box}; the scan spans {[*low.tolist(), *high.tolist()]} in world"


def _within(points: NDArray[np.floating], box: Array) -> NDArray[np.bool_]:
    """(...) bool: which of `points` (..., 3), world, lie in `box` (6,)."""
    inside = np.ones(points.shape[:-1], dtype=bool)
    for k in range(3):
        inside &= (points[..., k] >= box[k]) & (points[..., k] <= box[k + 3])
    return inside


def _in_region(scan: Scan, roi: Array | None) -> NDArray[np.bool_]:
    """(height, width): where something is measured in the region."""
    measured: NDArray[np.bool_] = scan.depth > 0
    return measured if roi is None else measured & _within(points_in_world(scan.camera, scan.depth), roi)


def _tolerance(depth: NDArray[np.floating], base: float, growth: float) -> NDArray[np.floating]:
    return base + growth * depth**2


def scene_points(
    scans: Sequence[Scan],
    roi: Array | None = None,
    base: float = PLANE_TOLERANCE,
    growth: float = PLANE_TOLERANCE_GROWTH,
) -> ScenePoints:
    """The oriented points of all `scans`, whole, thinned to about PLANE_WIDTH pixels across.

    base, growth : of a plane's tolerance, as `observe` has them
    """
    points, normals, tolerances, border = [], [], [], []
    for scan in scans:
        factor = max(min(scan.camera.width // PLANE_WIDTH, scan.camera.height), 1)
        w, h = scan.camera.width // factor, scan.camera.height // factor
        # The middle pixel of a block: the median of `work_image` costs more and a plane averages anyway.
        middle = factor // 2
        depth = scan.depth[middle : h * factor : factor, middle : w * factor : factor][:h, :w]
        # Each kept pixel's own ray, not that of its block's centre.
        camera = replace(
            scan.camera,
            width=w,
            height=h,
            fx=scan.camera.fx / factor,
            fy=scan.camera.fy / factor,
            cx=(scan.camera.cx - middle) / factor,
            cy=(scan.camera.cy - middle) / factor,
        )
        valid = depth > 0
        world = points_in_world(camera, depth)
        rotation = poses.to_matrix(camera.pose_world_camera)[:3, :3]
        at_border = np.zeros((h, w), dtype=bool)
        edge = max(min(h, w) // 30, 1)
        at_border[:edge] = at_border[-edge:] = at_border[:, :edge] = at_border[:, -edge:] = True
        points.append(world[valid].astype(np.float64))
        normals.append(surface_normals(depth, camera)[valid].astype(np.float64) @ rotation.T)
        tolerances.append(_tolerance(depth[valid].astype(np.float64), base, growth))
        border.append(at_border[valid])
    all_points = np.concatenate(points)
    inside = np.zeros(len(all_points), dtype=bool) if roi is None else _within(all_points, roi)
    return ScenePoints(
        all_points, np.concatenate(normals), np.concatenate(tolerances), np.concatenate(border), inside, roi is not None
    )


def pixel_categories(
    depth: NDArray[np.float32],
    world: NDArray[np.float32],
    roi: Array | None,
    planes: Array,
    base: float = PLANE_TOLERANCE,
    growth: float = PLANE_TOLERANCE_GROWTH,
) -> NDArray[np.uint8]:
    """What each pixel is to the unary potential, as `View.category`. depth : (...) metres; world : (..., 3) its points;
    roi, planes : of the observation; base, growth : the planes' tolerance"""
    tolerance = _tolerance(depth, base, growth)
    category = np.full(depth.shape, OBJECT, dtype=np.uint8)
    if roi is not None:
        category[~_within(world, roi)] = OUTSIDE
    for plane in planes:
        signed = world @ plane[:3].astype(np.float32) + np.float32(plane[3])
        # Behind the plane there is only noise of the plane, hence the longer reach on that side.
        category[(signed < tolerance) & (signed > -3 * tolerance)] = SUPPORT
    category[depth <= 0] = NO_DEPTH
    return category


def _view(
    image: WorkImage,
    distortion: float,
    roi: Array | None,
    planes: Array,
    upright: NDArray[np.bool_],
    base: float,
    growth: float,
) -> View:
    """The view of a work image. upright : (K,) which of the `planes` (K, 4) are walls"""
    depth, camera = image.depth, image.camera
    points = points_in_world(camera, depth)
    category, others = (pixel_categories(depth, points, roi, some, base, growth) for some in (planes, planes[~upright]))
    normals = surface_normals(depth, camera)
    for array in (depth, category, normals):
        array.setflags(write=False)
    view = View(camera, depth, category, normals, image.turn, distortion, image.binned)
    return _without_flush_patches(view, others, planes[upright])


def _without_flush_patches(view: View, others: NDArray[np.uint8], walls: Array) -> View:
    """The view in which a smooth patch that is parallel to a wall and stands before it is not on it: a shut door is a
    few centimetres away, and a pixel's tolerance as large at three metres, where many tell better than one.

    others : (h, w) the categories without walls; walls : (K, 4) support planes, world
    """
    on_wall = (view.category == SUPPORT) & (others != SUPPORT)
    if not on_wall.any():
        return view
    points, category = view.points, view.category.copy()
    facing = poses.rotate(poses.quaternion_conjugate(view.camera.pose_world_camera[3:]), walls[:, :3])
    for number in np.unique(view.patches[on_wall & (view.patches > 0)]):
        patch = view.patches == number
        before = np.median(points[patch] @ walls[:, :3].T + walls[:, 3], axis=0)
        mean = view.normals[patch].sum(axis=0)
        parallel = facing @ mean > PARALLEL * np.linalg.norm(mean)
        if parallel.any() and before[parallel].min() > FLUSH:
            category[on_wall & patch] = others[on_wall & patch]
    return view.with_category(category)


def _oriented_points(view: View) -> tuple[Array, Array]:
    """Those of the view's points that may be the object and have a normal, and these, (P, 3) each, world."""
    chosen = (view.category == OBJECT) & (view.normals != 0).any(axis=-1)
    rotation = poses.to_matrix(view.camera.pose_world_camera)[:3, :3]
    points = view.points[chosen].astype(np.float64)
    return points, view.normals[chosen].astype(np.float64) @ rotation.T


def without_longer_surfaces(observation: Observation, length: float) -> Observation:
    """The observation of an object that is at most `length` metres long: what lies on a longer smooth surface is
    CONTINUED where it was OBJECT, and none of `points`. As it is where nothing is left."""
    longer = [(patch_lengths(view.patches, view.points) > length)[view.patches] for view in observation.views]
    left = _but(observation, longer, CONTINUED)
    return left if len(left.points) else observation


def without_pixels(observation: Observation, taken: Sequence[NDArray[np.bool_]]) -> Observation:
    """The observation without what is `taken` (h, w) of each view: OUTSIDE where it was OBJECT, and none of `points`,
    of which there may be none."""
    return _but(observation, taken, OUTSIDE)


def _but(observation: Observation, chosen: Sequence[NDArray[np.bool_]], category: int) -> Observation:
    """The observation with the OBJECT pixels that are `chosen` (h, w) of each view in another category."""
    views, points, normals = [], [np.zeros((0, 3))], [np.zeros((0, 3))]
    for view, some in zip(observation.views, chosen, strict=True):
        changed = np.where(some & (view.category == OBJECT), np.uint8(category), view.category)
        views.append(view.with_category(changed))
        view_points, view_normals = _oriented_points(views[-1])
        points.append(view_points)
        normals.append(view_normals)
    return replace(observation, views=tuple(views), points=np.concatenate(points), normals=np.concatenate(normals))


def presumed_up(scans: Sequence[Scan], up: Array | None) -> Array:
    """(3,) unit vector: which way is up before any plane is known. Raises ScanError where `up` is no direction."""
    if up is not None:
        given = np.array(up, dtype=np.float64)
        length = np.linalg.norm(given)
        if given.shape != (3,) or not np.isfinite(given).all() or length < 1e-9:
            raise ScanError(f"up is {np.asarray(up).tolist()!r:.80}; expected three numbers, a direction in world")
        return given / length
    return np.array([0.0, 0.0, 1.0]) if has_pose(scans) else np.array([0.0, -1.0, 0.0])


def up_direction(scans: Sequence[Scan], planes: Array, up: Array | None) -> Array:
    """(3,) unit vector: which way is up once the support `planes` (K, 4) are known."""
    presumed = presumed_up(scans, up)
    if up is not None or has_pose(scans) or len(planes) == 0:
        return presumed
    cosine = planes[:, :3] @ presumed
    best = int(cosine.argmax())
    return planes[best, :3].copy() if cosine[best] > FLOOR_COSINE else presumed
