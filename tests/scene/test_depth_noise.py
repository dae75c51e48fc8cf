"""The scan's noise, read off its own surfaces, is what was added to them."""

from __future__ import annotations

import numpy as np
import pytest

from pmpnbp.geometry.camera import Camera
from pmpnbp.scene.depth_noise import depth_noise
from pmpnbp.scene.observation import NO_DEPTH, OBJECT, OUTSIDE, View

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


def test_without_noise_or_object_there_is_none(rng: np.random.Generator) -> None:
    assert depth_noise(seen(rng, 0.0)) < 1e-5
    view = seen(rng, 0.01)
    nothing = View(view.camera, view.depth, np.full(view.depth.shape, OUTSIDE, np.uint8), view.normals)
    assert depth_noise(nothing) == 0.0
    empty = View(view.camera, np.zeros_like(view.depth), np.zeros_like(view.category), view.normals)
    assert depth_noise(empty) == 0.0
