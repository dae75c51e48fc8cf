"""How does the estimate look on the scan? A PNG without a browser: the scan's depth in calm greys as the camera sees
it, and over it the parts where the estimate has them, one colour each.

Where the scan shows something in front of a part, only a tint of the part and a fainter outline are drawn, so that what
is seen and what is inferred can be told apart.
"""

from __future__ import annotations

import io
import logging
from collections.abc import Hashable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from threading import Lock

import numpy as np
from cachetools import LRUCache
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.pictures.backdrop import LIGHT, backdrop_and_depth, resized, scaled
from pmpnbp.pictures.palette import INK, PAPER, part_colours, rgb
from pmpnbp.pictures.part_images import NOTHING, PartImage, PartImages
from pmpnbp.potentials.pixel_kinds import in_front
from pmpnbp.readout.placement import VISIBLE_TOLERANCE
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.observation import Scan

# Pixels drawn for each of the picture's, across and down, in a picture of up to so many pixels; in larger ones one.
FINER, FINER_UP_TO = 2, 1_000_000
# Pixels along the longer side, at most: as much as is drawn in a second or two.
LONGEST = 2048
# Up to this width parts are drawn finer than a small scan's pixels.
ENOUGH = 640
# How many pictures, and how many scans in grey, are kept.
KEPT, KEPT_BACKDROPS = 64, 8
# Of a part's colour over the scan, and of its outline: where it is seen, and where something is in front of it.
SURFACE, SURFACE_HIDDEN = 0.92, 0.22
OUTLINE, OUTLINE_HIDDEN = 0.85, 0.50
# Surfaces seen at a flatter angle (cosine) are compared with the scan as if seen at this one.
FLATTEST = 0.25

_log = logging.getLogger("pmpnbp.pictures")

Grey = NDArray[np.float32]
Colour = NDArray[np.float32]


class Pictures:
    """Draws, one picture at a time in a thread of its own, and keeps what it is asked to keep."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="pictures")
        self._images: PartImages | None = None
        self._backdrops: LRUCache[Hashable, tuple[NDArray[np.uint8], NDArray[np.float32]]] = LRUCache(KEPT_BACKDROPS)
        self._kept: LRUCache[Hashable, bytes] = LRUCache(KEPT)
        self._lock = Lock()

    def draw(
        self,
        scan: Scan,
        model: ArticulatedObject,
        part_poses: Array,
        width: int | None = None,
        *,
        scan_name: Hashable = None,
    ) -> bytes:
        """A PNG of the parts at `part_poses` (N, 7), part in world, over `scan`.

        width : pixels, see `picture_size`; default: the camera's; the height follows
        scan_name : where given, the scan's own; the grey picture of a scan of this name is used again

        Raises DrawingError where this machine cannot draw.
        """
        return self._thread.submit(self._draw, scan, model, part_poses, width, scan_name).result()

    def kept(self, name: Hashable) -> bytes | None:
        """The picture that was last kept under this name, if it still is."""
        with self._lock:
            return self._kept.get(name)

    def keep(self, name: Hashable, picture: bytes) -> None:
        """Keep a picture under a name, until KEPT others have been asked for since."""
        with self._lock:
            self._kept[name] = picture

    def close(self) -> None:
        """Free what is held, after the picture being drawn."""
        self._thread.submit(self._close)
        self._thread.shutdown()

    def _draw(
        self, scan: Scan, model: ArticulatedObject, part_poses: Array, width: int | None, scan_name: Hashable
    ) -> bytes:
        across, down = picture_size(scan, width)
        finer = FINER if across * down <= FINER_UP_TO else 1
        parts = self._part_image(scaled(scan.camera, finer * across, finer * down), model, part_poses)
        grey, depth = self._prepared(scan, across, down, scan_name)
        return png(composed(grey, depth, parts, len(model.parts)))

    def _part_image(self, camera: Camera, model: ArticulatedObject, part_poses: Array) -> PartImage:
        if self._images is not None:
            try:
                return self._images.draw(camera, model, part_poses)
            except Exception as error:
                # Whoever else in this process ends its own use of EGL takes the display from all: begin anew.
                _log.warning("drawing begins anew after %s: %s", type(error).__name__, error)
                self._close()
        self._images = PartImages()
        return self._images.draw(camera, model, part_poses)

    def _prepared(
        self, scan: Scan, across: int, down: int, scan_name: Hashable
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """The scan in grey, and its depth at that size."""
        name = (scan_name, across)
        if scan_name is not None and name in self._backdrops:
            return self._backdrops[name]
        picture, depth = backdrop_and_depth(scan, across, down)
        prepared = _to_bytes(picture), depth
        if scan_name is not None:
            self._backdrops[name] = prepared
        return prepared

    def _close(self) -> None:
        images, self._images = self._images, None
        if images is not None:
            with suppress(Exception):  # of a display that is gone nothing is left to free
                images.close()


def picture_size(scan: Scan, width: int | None) -> tuple[int, int]:
    """Width and height in pixels of a picture for which `width` was asked: the camera's width at most, or ENOUGH where
    that is less; neither above LONGEST."""
    camera = scan.camera
    wanted = camera.width if width is None else min(width, max(camera.width, ENOUGH))
    across = min(wanted, LONGEST, max(LONGEST * camera.width // camera.height, 1))
    return across, max(round(camera.height * across / camera.width), 1)


def composed(behind: NDArray[np.uint8], depth: NDArray[np.float32], parts: PartImage, count: int) -> NDArray[np.uint8]:
    """The picture (h, w, 3), sRGB: `count` parts, drawn a whole number of times as large, over the picture `behind`
    (h, w, 3) of a scan (h, w), metres."""
    picture = behind.copy()
    finer = parts.part.shape[0] // depth.shape[0]
    rows, columns = _box(parts.part != NOTHING, finer)
    fine = tuple(slice(finer * side.start, finer * side.stop) for side in (rows, columns))
    cut = PartImage(parts.depth[fine], parts.part[fine], parts.normal[fine], parts.cosine[fine])
    if cut.part.size:
        hidden = _hidden(resized(depth[rows, columns], cut.part.shape[1], cut.part.shape[0]), cut, finer)
        surface = np.where(cut.part != NOTHING, SURFACE + (SURFACE_HIDDEN - SURFACE) * hidden, 0)
        line = outlines(cut) * (OUTLINE + (OUTLINE_HIDDEN - OUTLINE) * hidden)
        colour = shaded(cut, count)
        colour += line[..., None] * (_outline_colours(count)[cut.part] - colour)
        strength = np.maximum(surface, line).astype(np.float32)[..., None]
        under = picture[rows, columns].astype(np.float32) / 255
        picture[rows, columns] = _to_bytes(under * (1 - _mean(strength, finer)) + _mean(colour * strength, finer))
    return picture


def shaded(parts: PartImage, count: int) -> Colour:
    """Each part's colour (h, w, 3), 0 to 1, lit as the scan is."""
    lit = np.clip(parts.normal @ LIGHT, -1, 1)
    brightness = 0.62 + 0.42 * (0.5 + 0.5 * lit) ** 1.3
    shine = 0.10 * np.maximum(lit, 0) ** 3
    return np.clip(_colours(count)[parts.part] * brightness[..., None] + shine[..., None], 0, 1).astype(np.float32)


def outlines(parts: PartImage) -> Grey:
    """Where a part ends, 0 to 1: at its rim, where another begins, and where its depth jumps."""
    part, depth = parts.part, parts.depth
    ends = np.zeros(part.shape, dtype=bool)
    for here, there in (
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
    ):
        jump = np.abs(depth[here] - depth[there]) > 0.02 + 0.01 * np.minimum(depth[here], depth[there])
        step = (part[here] != part[there]) | jump
        ends[here] |= step
        ends[there] |= step
    return np.minimum(ndimage.gaussian_filter(ends.astype(np.float32), 0.55) / 0.75, 1)


def png(picture: NDArray[np.uint8]) -> bytes:
    """A picture (h, w, 3) as the bytes of a PNG."""
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "png", compress_level=5)
    return buffer.getvalue()


def _box(covered: NDArray[np.bool_], finer: int) -> tuple[slice, slice]:
    """Rows and columns of the picture that hold what is covered, with room for its outline; empty where nothing is."""
    sides = []
    for axis in (1, 0):
        at = np.flatnonzero(covered.any(axis=axis))
        length = covered.shape[1 - axis] // finer
        first, last = (int(at[0]) // finer, int(at[-1]) // finer) if len(at) else (0, -1)
        sides.append(slice(max(first - 2, 0), min(last + 3, length)) if len(at) else slice(0, 0))
    return sides[0], sides[1]


def _hidden(depth: NDArray[np.float32], parts: PartImage, finer: int) -> Grey:
    """How far the scan `depth` is in front of the parts, 0 to 1, borders softened and single pixels ignored. On a
    surface seen at a flat angle a small error across is a large one in depth."""
    tolerance = VISIBLE_TOLERANCE / np.maximum(parts.cosine, FLATTEST)
    behind = (parts.part != NOTHING) & in_front(depth, parts.depth, tolerance)
    share = ndimage.uniform_filter(behind.astype(np.float32), 2 * finer + 1)
    hidden = np.clip(2 * ndimage.gaussian_filter(share, 0.5 * finer) - 0.5, 0, 1)
    return hidden.astype(np.float32)


def _colours(count: int) -> Colour:
    """(N + 1, 3), 0 to 1; the last is for NOTHING, which is the index -1."""
    return np.array([*part_colours(count), rgb(PAPER)], dtype=np.float32) / np.float32(255)


def _outline_colours(count: int) -> Colour:
    """(N + 1, 3): a dark shade of each part's colour, and ink for the pixels around."""
    ink = np.array(rgb(INK), dtype=np.float32) / 255
    dark: Colour = (0.45 * _colours(count) + 0.15 * ink).astype(np.float32)
    dark[NOTHING] = ink
    return dark


def _mean(fine: NDArray[np.float32], finer: int) -> NDArray[np.float32]:
    """An image drawn `finer` times as large, at the picture's size."""
    height, width = fine.shape[0] // finer, fine.shape[1] // finer
    return fine.reshape(height, finer, width, finer, fine.shape[2]).mean(axis=(1, 3))


def _to_bytes(picture: NDArray[np.floating]) -> NDArray[np.uint8]:
    return np.round(np.clip(picture, 0, 1) * 255).astype(np.uint8)
