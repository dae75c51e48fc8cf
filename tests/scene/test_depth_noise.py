"""The scan's noise, read off its own surfaces, is what was added to them."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from scipy import ndimage

from pmpnbp.geometry.camera import Camera
from pmpnbp.scene.depth_noise import COEFFICIENTS, LEAST, NEAR, WIDEST, _deviation, depth_noise
from pmpnbp.scene.observation import NO_DEPTH, OBJECT, OUTSIDE, View
from pmpnbp.settings import SENSORS, Settings
from sample_data import sensor

CAMERA = Camera(120, 90, 100.0, 100.0, 59.5, 44.5)


def seen(rng: np.random.Generator, coefficient: float, window: float = 0.0, holes: float = 0.1) -> View:
    """A tilted wall with a box before it, an object, and noise of `coefficient` z², metres, which neighbours within a
    `window`, a standard deviation in pixels, share; of `holes`, a share, nothing is measured."""
    column, _ = np.meshgrid(np.arange(120), np.arange(90))
    depth = 1.0 / (0.5 + 0.3 * (column - 59.5) / 100.0)
    category = np.full(depth.shape, OUTSIDE, np.uint8)
    category[30:60, 40:80] = OBJECT
    depth[30:60, 40:80] = 1.5
    depth = depth + coefficient * depth**2 * shared(rng, window)
    lost = rng.random(depth.shape) < holes
    category[lost] = NO_DEPTH
    depth[lost] = 0.0
    return View(CAMERA, depth.astype(np.float32), category, np.zeros((*depth.shape, 3), np.float32))


def own_noise(view: View) -> float:
    """Metres: the deviation that neighbours' differences have, in the median, about as far away as the object."""
    near = (view.depth > view.distance / NEAR) & (view.depth < view.distance * NEAR)
    inverse = np.where(near, 1 / np.where(near, view.depth, 1), np.nan)
    return _deviation(inverse, 1)[0] * view.distance**2


def shared(rng: np.random.Generator, window: float) -> np.ndarray:
    """Standard normal deviates, white ones under a Gaussian window: the variances of sums of many are larger by the sum
    of their autocorrelation, 4 pi window²."""
    wide = rng.standard_normal((130, 160))
    if window:
        wide = 2 * np.sqrt(np.pi) * window * ndimage.gaussian_filter(wide, window)
    return wide[20:-20, 20:-20]


@pytest.mark.parametrize("coefficient", [0.001, 0.004, 0.01])
def test_it_is_that_of_the_sensor_at_the_object(rng: np.random.Generator, coefficient: float) -> None:
    """Of some 13,000 second differences, a third of them independent, the median is off by 2 % (one deviation); steps
    at the box's edges make it larger by as much. 15 % is never met by chance."""
    assert depth_noise(seen(rng, coefficient)).std == pytest.approx(coefficient * 1.5**2, rel=0.15)


@pytest.mark.parametrize(
    ("kind", "near", "far"), [("structured_light", 1.9e-3, 14.1e-3), ("time_of_flight", 1.3e-3, 2.7e-3)]
)
def test_a_kind_of_sensor_has_its_own(rng: np.random.Generator, kind: str, near: float, far: float) -> None:
    """At 1 m and at 3 m, worked out by hand from the publications' formulas, whatever the scan's own noise is."""
    for distance, expected in ((1.0, near), (3.0, far)):
        view = seen(rng, 0.03)
        view.depth[view.category == OBJECT] = distance
        assert depth_noise(view, kind).std == pytest.approx(expected, abs=3e-4)


def test_stereo_grows_with_the_square_of_depth(rng: np.random.Generator) -> None:
    """By hand: z² times a tenth of a pixel over 600 pixels times 0.05 m."""
    assert depth_noise(seen(rng, 0.001), "stereo").std == pytest.approx(1.5**2 * 0.1 / (600 * 0.05), rel=0.02)


def test_the_sensors_are_those_of_the_setting_and_of_rendered_scans() -> None:
    (choices,) = [entry.metadata["choices"] for entry in fields(Settings) if entry.name == "sensor"]
    assert choices == (Settings.sensor, *SENSORS)
    assert set(SENSORS) == set(COEFFICIENTS) == set(sensor.KINDS)


def test_without_noise_or_object_there_is_none(rng: np.random.Generator) -> None:
    assert depth_noise(seen(rng, 0.0)).std < 1e-5
    view = seen(rng, 0.01)
    nothing = View(view.camera, view.depth, np.full(view.depth.shape, OUTSIDE, np.uint8), view.normals)
    assert depth_noise(nothing) == (0.0, 1.0)
    assert depth_noise(nothing, "stereo") == (0.0, 1.0)
    empty = View(view.camera, np.zeros_like(view.depth), np.zeros_like(view.category), view.normals)
    assert depth_noise(empty) == (0.0, 1.0)


@pytest.mark.parametrize("coefficient", [0.0005, 0.002, 0.01])
@pytest.mark.parametrize("holes", [0.0, 0.1])
def test_pixels_that_err_each_on_its_own_are_told_so(coefficient: float, holes: float) -> None:
    """False-alarm rate: below 1e-6 a scan; of 600 the largest variance of blocks' means was 1.9 of ALONE's 3."""
    for seed in range(20):
        assert depth_noise(seen(np.random.default_rng(seed), coefficient, holes=holes)).area == 1.0


@pytest.mark.parametrize("window", [0.8, 1.2])
@pytest.mark.parametrize("holes", [0.0, 0.03])
def test_of_pixels_that_err_together_it_tells_how_far_off_many_are(window: float, holes: float) -> None:
    """The variance of a sum is 4 pi window² times that of as many which err each on its own. Blocks of eight pixels are
    not wide beside the windows: three quarters and two thirds of it are found, in a hundred seeds 0.56 to 1.01 and 0.45
    to 0.82. False-alarm rate: below 1e-4 a scan."""
    for seed in range(5):
        view = seen(np.random.default_rng(seed), 0.002, window, holes)
        std, area = depth_noise(view)
        assert 0.35 < std**2 * area / (0.002 * 1.5**2) ** 2 / (4 * np.pi * window**2) < 1.2
        # neighbours' differences have less than a WIDEST of it: what is beyond is in the area
        assert std == pytest.approx(WIDEST * own_noise(view), rel=1e-9)


def test_a_deviation_that_neighbours_share_in_part_is_found() -> None:
    """Their differences have seven tenths of it; 1.07 to 1.19 of it were told in a hundred seeds.
    False-alarm rate: below 1e-3 a scan; the seeds are fixed."""
    for seed in range(5):
        assert depth_noise(seen(np.random.default_rng(seed), 0.002, 0.6)).std == pytest.approx(0.002 * 1.5**2, rel=0.25)


@pytest.mark.parametrize("bend", [0.0, 1e-5, 1e-4])
def test_some_err_together_or_none_does(bend: float) -> None:
    """Whatever the surfaces are, and however wide the window: never a share of a pixel, nor a smaller deviation."""
    column, row = np.meshgrid(np.arange(120), np.arange(90))
    for seed in range(8):
        rng = np.random.default_rng(seed)
        view = seen(rng, 0.001, rng.uniform(0.2, 3.0))
        view.depth[view.depth > 0] += (bend * ((column - 60) ** 2 + row**2))[view.depth > 0].astype(np.float32)
        std, area = depth_noise(view)
        assert area == 1.0 or area > LEAST - 1e-9
        assert std >= own_noise(view) * (1 - 1e-9)


def test_what_neighbours_share_a_kind_of_sensor_does_not_tell(rng: np.random.Generator) -> None:
    view = seen(rng, 0.002, 1.2)
    assert depth_noise(view, "stereo").area == depth_noise(view).area > 5


@pytest.mark.parametrize("deviations", [2.0, 3.0])
def test_steps_that_only_blocks_tell_are_no_noise_that_pixels_share(deviations: float) -> None:
    """A wall, two thirds of which are tiles of 14 pixels, off by so many of its noise's deviations.
    False-alarm rate: none of 200 seeds each; with the bends that blocks tell left in, 116 of 120 failed."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        tiles = np.kron(rng.standard_normal((13, 18)), np.ones((14, 14)))[:180, :240]
        tiles[:, :84] = 0.0
        depth = 1.5 + 0.002 * 1.5**2 * (deviations * tiles + rng.standard_normal((180, 240)))
        category = np.full(depth.shape, OBJECT, np.uint8)
        wall = View(CAMERA, depth.astype(np.float32), category, np.zeros((*depth.shape, 3), np.float32))
        assert depth_noise(wall).area == 1.0


def before_a_wall(rng: np.random.Generator, size: int) -> View:
    """An object `size` pixels across, 1.5 m away, before a wall at 4 m; noise of 0.002 z², metres, and five times that
    on the wall, shared by its pixels."""
    depth, category = np.full((90, 120), 4.0), np.full((90, 120), OUTSIDE, np.uint8)
    depth += 0.01 * depth**2 * shared(rng, 1.2)
    near = 1.5 + 0.002 * 1.5**2 * rng.standard_normal((size, size))
    depth[10 : 10 + size, 30 : 30 + size], category[10 : 10 + size, 30 : 30 + size] = near, OBJECT
    return View(CAMERA, depth.astype(np.float32), category, np.zeros((*depth.shape, 3), np.float32))


def test_a_wall_far_behind_the_object_is_not_asked(rng: np.random.Generator) -> None:
    """Of 7,000 second differences the median is off by 2 % (one deviation); in 150 seeds 0.95 to 1.04 of it were told.
    False-alarm rate: below 1e-6."""
    std, area = depth_noise(before_a_wall(rng, 60))
    assert std == pytest.approx(0.002 * 1.5**2, rel=0.15) and area == 1.0


def test_all_surfaces_are_asked_where_few_are_as_far_away_as_the_object(rng: np.random.Generator) -> None:
    """In 150 seeds 1.76 to 1.90 of the object's own were told, and 62 pixels and more. False-alarm rate: below 1e-4."""
    std, area = depth_noise(before_a_wall(rng, 12))
    assert std > 1.5 * 0.002 * 1.5**2 and area > 3.0


def test_too_few_blocks_tell_nothing(rng: np.random.Generator) -> None:
    """Of a picture of 10 by 8 pixels, whatever it holds."""
    view = seen(rng, 0.002, 2.5)
    small = View(view.camera, view.depth[40:48, 50:60], view.category[40:48, 50:60], view.normals[40:48, 50:60])
    assert depth_noise(small).area == 1.0
    assert depth_noise(small).std > 0
