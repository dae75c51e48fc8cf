"""Which colour has a point of the scan? By its depth, by how well the estimate explains it, or plain.

Kinds of fit are those of the pixel score, in the colours of the particle's picture. All is shaded as the scan's picture
is (`pmpnbp.pictures.backdrop`), so that surfaces can be told apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from app.viewer.scene_frame import Bytes, Floats
from app.viewer.view_state import THEMES, Theme
from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.pictures.backdrop import backdrop, resized, scaled
from pmpnbp.pictures.palette import KIND_COLOURS, rgb
from pmpnbp.potentials.pixel_kinds import pixel_kinds
from pmpnbp.potentials.surfaces import Surfaces
from pmpnbp.potentials.unary import render
from pmpnbp.scene.observation import Scan

# How brightly what is around the object is lit, at most: it must not end in the background.
_BRIGHTEST_AROUND = 1.05
# Points of one scan that are drawn, at most.
MOST = 80_000

# From near to far: what is far recedes into the background. What cannot be the object is neutral, and further from ink.
NEAR_FAR: Mapping[Theme, tuple[str, str]] = {"light": ("#6f86a3", "#b9c6d6"), "dark": ("#a9b8c9", "#46535f")}
AROUND: Mapping[Theme, tuple[str, str]] = {"light": ("#a3a8ae", "#cdd0d4"), "dark": ("#767b82", "#434950")}
PLAIN: Mapping[Theme, str] = {"light": "#a9b3be", "dark": "#6d7986"}


@dataclass(frozen=True)
class ScanPoints:
    """A scan as points, thinned.

    camera : of the thinned image; depth : (h, w), metres; measured : (h, w) bool, the pixels that are points
    points : (P, 3) world; shade : (P,) how brightly each is lit, about 1
    depth_colours, around_colours, plain_colours : (P, 3), for each theme, the first two by depth
    images : (h, w, 3), the depth image in the first colours
    """

    camera: Camera
    depth: Floats
    measured: NDArray[np.bool_]
    points: Floats
    shade: Floats
    depth_colours: Mapping[Theme, Bytes]
    around_colours: Mapping[Theme, Bytes]
    plain_colours: Mapping[Theme, Bytes]
    images: Mapping[Theme, Bytes]

    @cached_property
    def spacing(self) -> float:
        """Metres between neighbours in the middle of the depths."""
        return float(np.median(self.depth[self.measured])) / self.camera.fx if len(self.points) else 0.01


def scan_points(scan: Scan) -> ScanPoints:
    """The points of a scan: every pixel, or one of each block where there are more than MOST."""
    camera = scan.camera
    factor = max(int(np.ceil(np.sqrt(camera.width * camera.height / MOST))), 1)
    width, height = max(camera.width // factor, 1), max(camera.height // factor, 1)
    depth = resized(scan.depth, width, height)
    measured = depth > 0
    # each kept pixel's own ray, not that of its block's centre
    own = resized(camera.rays(), width, height)[measured] * depth[measured][:, None]
    points = poses.transform_points(camera.pose_world_camera, own.astype(np.float64)).astype(np.float32)
    values = depth[measured]
    near, far = np.percentile(values, (2, 98)) if len(values) else (0.0, 1.0)
    tone = np.clip((values - near) / max(far - near, 1e-6), 0, 1).astype(np.float32)
    shade = _shade(backdrop(scan, width, height)[measured].mean(axis=-1), tone)
    by_depth, around = (
        {theme: _lit(_between(*ends[theme], tone), light) for theme in THEMES}
        for ends, light in ((NEAR_FAR, shade), (AROUND, np.minimum(shade, _BRIGHTEST_AROUND)))
    )
    plain = {theme: _lit(_between(PLAIN[theme], PLAIN[theme], tone), shade) for theme in THEMES}
    return ScanPoints(
        scaled(camera, width, height),
        depth,
        measured,
        points,
        shade,
        by_depth,
        around,
        plain,
        {theme: _image(measured, by_depth[theme], theme) for theme in THEMES},
    )


def explained_colours(cloud: ScanPoints, theme: Theme, fit: NDArray[np.uint8]) -> Bytes:
    """(P, 3): the colours of kinds `fit` (P,), as `fits` gives them; what is not covered is plain."""
    found = cloud.plain_colours[theme].copy()
    for kind, colour in KIND_COLOURS.items():
        chosen = fit == kind
        found[chosen] = _lit(np.array([rgb(colour)], dtype=np.float32), cloud.shade[chosen])
    return found


def fits(
    cloud: ScanPoints, category: NDArray[np.uint8], surfaces: Surfaces, part_poses: Array, tolerance: float
) -> NDArray[np.uint8]:
    """(P,) the PixelKind of each point to the parts at `part_poses` (N, 7), part in world, rendered together.

    category : (P,) of the points, as `View.category`; tolerance : metres, the difference up to which one is explained
    """
    drawn, _ = render(cloud.camera, surfaces, part_poses)
    return pixel_kinds(cloud.depth[cloud.measured], category, drawn[cloud.measured], tolerance)


def _shade(grey: Floats, tone: Floats) -> Floats:
    """(P,) light alone: the backdrop's grey without what its depth makes of it."""
    if len(grey) < 2:
        return np.ones_like(grey)
    # of a wall seen head-on all depths, and so all tones, are one
    slope, level = np.polyfit(tone, grey, 1) if np.ptp(tone) > 0 else (0.0, grey.mean())
    return np.clip(1 + 1.4 * (grey - slope * tone - level), 0.7, 1.25).astype(np.float32)


def _between(near: str, far: str, tone: Floats) -> Floats:
    start, end = (np.array(rgb(colour), dtype=np.float32) for colour in (near, far))
    return start + (end - start) * tone[:, None]


def _lit(colour: Floats, shade: Floats) -> Bytes:
    return np.clip(colour * shade[:, None], 0, 255).astype(np.uint8)


def _image(measured: NDArray[np.bool_], painted: Bytes, theme: Theme) -> Bytes:
    """What was not measured is a darker plain colour."""
    picture = np.tile((0.5 * np.array(rgb(PLAIN[theme]))).astype(np.uint8), (*measured.shape, 1))
    picture[measured] = painted
    return picture
