"""A scan at working size: depths of blocks, and pixels that look where the scan's looked."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.scene.observation import Scan, View
from pmpnbp.scene.work_image import (
    DEVIATIONS,
    LEVEL,
    NO_SURFACE,
    ONE_SURFACE,
    TURN,
    block_depths,
    turned_back,
    work_image,
)

MARGIN = 15
# Columns and rows, in blocks, from the middle of a block of 4 x 4 pixels.
ACROSS, DOWN = np.tile((np.arange(4) - 1.5) / 4, 4), np.repeat((np.arange(4) - 1.5) / 4, 4)
CAMERA = Camera(320, 240, 280.0, 300.0, 155.0, 118.0, poses.from_xyz_rpy([0.4, -0.2, 1.0], [-2.0, 0.1, 0.5]))
# z = 1.5 + 0.3 x / z - 0.2 y / z, in the camera frame: linear in inverse depth over the image
PLANE = np.array([0.3, -0.2, -1.0])


def plane_depth(camera: Camera) -> np.ndarray:
    """Depths (h, w) of the plane PLANE . p + 1.5 = 0 in the frame of CAMERA, for cameras at its place."""
    turn = poses.quaternion_multiply(
        poses.quaternion_conjugate(CAMERA.pose_world_camera[3:]), camera.pose_world_camera[3:]
    )
    rays = poses.rotate(turn, camera.rays().astype(np.float64))
    return -1.5 / (rays @ PLANE)


@given(st.integers(0, 2**32 - 1), st.integers(1, 30), st.integers(1, 400), st.sampled_from([0.1, 0.5, 0.9]))
def test_a_block_has_the_plane_through_what_is_about_its_median(
    seed: int, blocks: int, pixels: int, holes: float
) -> None:
    """In its middle, by least squares of all at once, with slopes held by a weight. Of two in the middle the median is
    their mean, or if they are not of one surface the lower in every second block; nothing where less than half of the
    pixels were measured, or half of a whole block's are in the picture. One surface reaches as far as the deviation of
    inverse depth in the median block says, and a share of its depth at the least."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(1.0, 1.0 + rng.choice([0.01, 0.08, 2.0]), pixels).astype(np.float32)
    depth[rng.random(pixels) < holes] = 0.0
    block, size = rng.integers(blocks, size=pixels), int(rng.integers(1, 10))
    x, y = rng.uniform(-0.5, 0.5, (2, pixels)).round(1)
    found = block_depths(depth, block, blocks, size, (x, y))
    chosen = [np.flatnonzero((block == number) & (depth > 0)) for number in range(blocks)]
    chosen = [some[np.argsort(depth[some])] for some in chosen]
    owns = [depth[some].astype(np.float64) for some in chosen]
    lowers = [own[(len(own) - 1) // 2] if len(own) else 0.0 for own in owns]
    uppers = [own[len(own) // 2] if len(own) else 0.0 for own in owns]
    firsts = [(lower, upper)[number % 2] for number, (lower, upper) in enumerate(zip(lowers, uppers, strict=True))]
    squares = []
    for own, first in zip(owns, firsts, strict=True):
        if len(own):
            gaps = (own - first) / first**2
            squares.append(np.mean(gaps[np.abs(gaps) < NO_SURFACE] ** 2))
    deviation = float(np.sqrt(np.median(squares))) if squares else 0.0
    for number, own in enumerate(owns):
        count = np.count_nonzero(block == number)
        if len(own) == 0 or 2 * len(own) < count or 2 * count < size:
            assert found[number] == 0.0
            continue
        first = firsts[number]
        reach = max(ONE_SURFACE, DEVIATIONS * deviation * first) * first
        both = (lowers[number] + uppers[number]) / 2
        middle = both if uppers[number] - lowers[number] < reach else first
        near = np.abs(own - middle) < reach
        pixel = chosen[number][near]
        terms = np.stack([np.ones(len(pixel)), x[pixel], y[pixel]], axis=1)
        held = len(pixel) * np.diag([0.0, LEVEL, LEVEL])
        plane = np.linalg.solve(terms.T @ terms + held, terms.T @ own[near])
        assert found[number] == pytest.approx(plane[0], rel=1e-6)


@pytest.mark.parametrize(
    ("distance", "noise", "step", "left"),
    [
        (2.003, 0.006, 0.0, 0.003),
        (2.003, 0.006, 0.0115, 0.003),
        (3.007, 0.014, 0.0, 0.005),
        (3.007, 0.014, 0.0285, 0.005),
    ],
)
def test_a_noisy_surface_is_where_it_is(distance: float, noise: float, step: float, left: float) -> None:
    """At 2 and 3 m, with a camera's noise there, in any depths or in its steps, of which the surface is between two:
    the mean of 4,000 blocks of 16 is within 0.3 mm, four standard errors at least of what its blocks are off by."""
    rng = np.random.default_rng(5)
    depth = distance + noise * rng.standard_normal(64_000)
    depth = np.round(depth / step) * step if step else depth
    found = block_depths(
        depth.astype(np.float32), np.arange(64_000) // 16, 4_000, 16, (np.tile(ACROSS, 4_000), np.tile(DOWN, 4_000))
    )
    assert abs(found.mean() - distance) < 3e-4
    assert found.std() < left


def test_an_edge_is_where_it_is_however_many_pixels_a_block_has() -> None:
    """Of blocks of 16 pixels each 0 to 16 are of the nearer surface, and so are half of the blocks: of those in which
    both have eight, every second one."""
    nearer = np.tile(np.arange(17), 2)[:, None] > np.arange(16)
    depth = np.where(nearer, 1.0, 2.0).astype(np.float32).ravel()
    found = block_depths(depth, np.repeat(np.arange(34), 16), 34, 16, (np.tile(ACROSS, 34), np.tile(DOWN, 34)))
    assert np.mean(found == 1.0) == 0.5 and np.mean(found == 2.0) == 0.5


def test_an_edge_is_never_averaged() -> None:
    depth = np.full((240, 320), 1.0, dtype=np.float32)
    depth[:, 171:] = 2.0
    found = work_image(Scan(CAMERA, depth), depth > 0, 80, MARGIN)
    assert found is not None and found.turn == TURN
    assert set(np.unique(found.depth).tolist()) == {0.0, 1.0, 2.0}


def test_beside_an_edge_a_slanted_surface_is_where_it_is() -> None:
    """Of a plane that ends within blocks the pixels are on one side of them. Where its depths' mean would be taken for
    a block's middle, it would be off by up to a fifth of what it falls from block to block."""
    depth = plane_depth(CAMERA).astype(np.float32)
    depth[:, 171:] = 3.0
    found = work_image(Scan(CAMERA, depth), depth > 0, 80, MARGIN)
    assert found is not None
    plane = plane_depth(found.camera)
    on_plane = (found.depth > 0) & (found.depth < 2.9)
    beside = on_plane & (ndimage.maximum_filter(found.depth, size=3) == 3.0)
    off = (found.depth - plane)[beside] / np.abs(np.diff(plane, axis=1)).mean()
    assert len(off) > 40
    assert np.abs(off).max() < 0.05


@pytest.mark.parametrize("width", [50, 80, 160])
def test_pixels_are_where_the_scan_s_are(width: int) -> None:
    """A plane in the scan is the same plane in the image, whose camera has one focal length: within what a block
    is off by of which some pixels are not in the picture."""
    depth = plane_depth(CAMERA).astype(np.float32)
    wanted = np.zeros(depth.shape, dtype=bool)
    wanted[60:180, 90:240] = True
    found = work_image(Scan(CAMERA, depth), wanted, width, MARGIN)
    assert found is not None and found.camera.fx == found.camera.fy
    measured = found.depth > 0
    assert measured.mean() > 0.4
    off = np.abs(found.depth - plane_depth(found.camera))[measured]
    step = np.abs(np.diff(plane_depth(found.camera), axis=0)).max()
    assert np.median(off) < 0.01 * step and off.max() < 0.25 * step


def test_the_image_is_as_large_as_what_is_wanted_of_the_scan() -> None:
    depth = plane_depth(CAMERA).astype(np.float32)
    wanted = np.zeros(depth.shape, dtype=bool)
    wanted[100:140, 110:210] = True
    cropped = work_image(Scan(CAMERA, depth), wanted, 160, MARGIN)
    assert cropped is not None and cropped.turn == 0.0 and cropped.binned == 1
    assert cropped.depth.shape == (40 + 2 * MARGIN, 100 + 2 * MARGIN)
    np.testing.assert_array_equal(cropped.depth, depth[85:155, 95:225])
    np.testing.assert_allclose(cropped.depth, plane_depth(cropped.camera), rtol=1e-5)
    binned = work_image(Scan(CAMERA, depth), wanted, 50 + 2 * MARGIN, MARGIN)
    assert binned is not None and binned.turn == TURN
    inside = turned_back(binned.depth, binned.turn, binned.camera) > 0
    h, w = inside.shape
    assert inside[h // 2].sum() <= w and abs(h / w - 1) < 0.3
    assert work_image(Scan(CAMERA, depth), np.zeros(depth.shape, dtype=bool), 160, MARGIN) is None


@pytest.mark.parametrize(
    ("length", "factor"), [(np.inf, 6), (1.0, 6), (0.7, 5), (0.48, 3), (0.01, 3), (0.0, 3)], ids=str
)
def test_what_is_much_shorter_than_the_region_has_finer_pixels(length: float, factor: int) -> None:
    """280 pixels of the scan, 50 of the image: at 2 m, where a metre has 150 of the scan's, as in a region that is
    twice as long as what is looked for, but no more than twice as fine."""
    depth = np.full((240, 320), 2.0, dtype=np.float32)
    wanted = np.zeros(depth.shape, dtype=bool)
    wanted[20:220, 20:300] = True
    found = work_image(Scan(CAMERA, depth), wanted, 50 + 2 * MARGIN, MARGIN, length)
    assert found is not None
    assert found.binned == factor
    assert found.camera.fx == pytest.approx(np.sqrt(CAMERA.fx * CAMERA.fy) / factor)


def test_of_a_region_that_nothing_is_measured_in_the_length_tells_nothing() -> None:
    depth = np.zeros((240, 320), dtype=np.float32)
    images = [work_image(Scan(CAMERA, depth), depth == 0, 80, MARGIN, length) for length in (0.1, np.inf)]
    assert images[0] is not None and images[1] is not None
    assert images[0].depth.shape == images[1].depth.shape


def test_a_level_edge_is_crossed_by_every_row() -> None:
    """Of the pixels beside a level edge as many are above it by a tenth of a pixel as by any other."""
    rows = (np.arange(200) * np.tan(TURN)) % 1.0
    assert np.abs(np.sort(rows) - (np.arange(200) + 0.5) / 200).max() < 0.02


def test_what_is_turned_back_looks_as_the_scan_does() -> None:
    depth = np.full((240, 320), 2.0, dtype=np.float32)
    depth[90:150, 120:200] = 1.0
    found = work_image(Scan(CAMERA, depth), depth > 0, 80, MARGIN)
    assert found is not None
    upright = turned_back(found.depth, found.turn, found.camera)
    rows, columns = np.nonzero(upright == 1.0)
    assert np.ptp(rows) + 1 == pytest.approx(60 * found.camera.fy / CAMERA.fy, abs=2)
    assert (upright[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1] == 1.0).mean() > 0.8


def test_a_view_knows_its_scan_s_camera() -> None:
    depth = plane_depth(CAMERA).astype(np.float32)
    found = work_image(Scan(CAMERA, depth), depth > 0, 80, MARGIN)
    assert found is not None
    view = View(found.camera, found.depth, np.ones_like(found.depth, dtype=np.uint8), np.zeros((1, 1, 3)), found.turn)
    np.testing.assert_allclose(view.pose_world_scan, CAMERA.pose_world_camera, atol=1e-12)
