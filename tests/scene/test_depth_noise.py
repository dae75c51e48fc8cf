"""The scan's noise, read off its own surfaces, is what was added to them."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from pmpnbp.geometry.camera import Camera
from pmpnbp.scene.depth_noise import SENSORS, depth_noise
from pmpnbp.scene.observation import NO_DEPTH, OBJECT, OUTSIDE, View
from pmpnbp.settings import Settings

CAMERA = Camera(120, 90, 100.0, 100.0, 59.5, 44.5)


def seen(rng: np.random.Generator, coefficient: float) -> View:
    """A tilted wall with a box before it, an object, and noise of `coefficient` z², metres; a tenth is not measured."""
    column, _ = np.meshgrid(np.arange(120), np.arange(90))
    depth = 1.0 / (0.5 + 0.3 * (column - 59.5) / 100.0)
    category = np.full(depth.shape, OUTSIDE, np.uint8)
    category[30:60, 40:80] = OBJECT
    depth[30:60, 40:80] = 1.5
    depth = depth + coefficient * depth**2 * rng.standard_normal(depth.shape)
    holes = rng.random(depth.shape) < 0.1
    category[holes] = NO_DEPTH
    depth[holes] = 0.0
    return View(CAMERA, depth.astype(np.float32), category, np.zeros((*depth.shape, 3), np.float32))


@pytest.mark.parametrize("coefficient", [0.001, 0.004, 0.01])
def test_it_is_that_of_the_sensor_at_the_object(rng: np.random.Generator, coefficient: float) -> None:
    """Of some 13,000 second differences, a third of them independent, the median is off by 2 % (one deviation); steps
    at the box's edges make it larger by as much. 15 % is never met by chance."""
    assert depth_noise(seen(rng, coefficient)) == pytest.approx(coefficient * 1.5**2, rel=0.15)


@pytest.mark.parametrize(
    ("sensor", "near", "far"), [("structured_light", 1.9e-3, 14.1e-3), ("time_of_flight", 1.3e-3, 2.7e-3)]
)
def test_a_kind_of_sensor_has_its_own(rng: np.random.Generator, sensor: str, near: float, far: float) -> None:
    """At 1 m and at 3 m, worked out by hand from the publications' formulas, whatever the scan's own noise is."""
    for distance, expected in ((1.0, near), (3.0, far)):
        view = seen(rng, 0.03)
        view.depth[view.category == OBJECT] = distance
        assert depth_noise(view, sensor) == pytest.approx(expected, abs=3e-4)


def test_stereo_grows_with_the_square_of_depth(rng: np.random.Generator) -> None:
    """By hand: z² times a tenth of a pixel over 600 pixels times 0.05 m."""
    assert depth_noise(seen(rng, 0.001), "stereo") == pytest.approx(1.5**2 * 0.1 / (600 * 0.05), rel=0.02)


def test_the_sensors_are_those_of_the_setting() -> None:
    (choices,) = [entry.metadata["choices"] for entry in fields(Settings) if entry.name == "sensor"]
    assert set(choices) == {Settings.sensor, *SENSORS}


def test_without_noise_or_object_there_is_none(rng: np.random.Generator) -> None:
    assert depth_noise(seen(rng, 0.0)) < 1e-5
    view = seen(rng, 0.01)
    nothing = View(view.camera, view.depth, np.full(view.depth.shape, OUTSIDE, np.uint8), view.normals)
    assert depth_noise(nothing) == 0.0
    assert depth_noise(nothing, "stereo") == 0.0
    empty = View(view.camera, np.zeros_like(view.depth), np.zeros_like(view.category), view.normals)
    assert depth_noise(empty) == 0.0
