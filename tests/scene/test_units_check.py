"""Millimetres taken for metres are told before anything is searched for."""

from __future__ import annotations

import numpy as np
import pytest

from pmpnbp.errors import ScanError
from pmpnbp.geometry.camera import Camera
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.observe import observe
from pmpnbp.scene.units_check import check_units

CAMERA = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)


def scan(nearest: float, farthest: float, camera: Camera = CAMERA) -> Scan:
    """Depths from one to the other, metres, and none in the first row."""
    depth = np.linspace(nearest, farthest, camera.width * camera.height, dtype=np.float32)
    depth[: camera.width] = 0
    return Scan(camera, depth.reshape(camera.height, camera.width))


@pytest.mark.parametrize(
    ("length", "scans"),
    [
        (0.001, [scan(0.04, 0.05)]),
        (0.12, [scan(0.5, 4.0)]),
        (30.0, [scan(0.5, 4.0)]),
        (30.0, [scan(40.0, 80.0)]),
        (0.7, [scan(30.0, 80.0)]),
        (700.0, [scan(500.0, 900.0)]),
        (0.0, [scan(500.0, 900.0)]),
        (np.inf, [scan(0.5, 4.0)]),
        (0.7, [scan(500.0, 900.0), scan(0.5, 4.0)]),
        (0.7, [scan(0.0, 0.0)]),
        (0.7, []),
    ],
)
def test_what_can_be_is_taken(length: float, scans: list[Scan]) -> None:
    check_units(length, scans)


def test_a_model_in_millimetres_is_told() -> None:
    with pytest.raises(ScanError, match=r"the model is 750 m long, .* farther than 4\.\d* m .*is the model in millim"):
        check_units(750.0, [scan(0.5, 4.0), scan(0.5, 2.0)])


def test_a_scan_whose_unit_is_too_large_is_told() -> None:
    with pytest.raises(ScanError, match=r"the model is 0\.75 m long, .* farther than 0\.0\d* m .*is the scan in anoth"):
        check_units(0.75, [scan(0.001, 0.002)])


def test_a_scan_in_millimetres_is_told() -> None:
    with pytest.raises(ScanError, match=r"the model is 0\.75 m long, 0\.\d* pixels .* away; .*is the scan in millim"):
        check_units(0.75, [scan(500.0, 1000.0), scan(600.0, 1000.0)])
    # as many pixels as it has by a longer lens
    check_units(0.75, [scan(500.0, 1000.0), scan(600.0, 1000.0, Camera(64, 48, 900.0, 900.0, 31.5, 23.5))])


def test_it_is_told_before_the_region_is_asked_for() -> None:
    with pytest.raises(ScanError, match="is the model in millimetres"):
        observe([scan(0.5, 4.0)], np.array([100.0, 100.0, 100.0, 101.0, 101.0, 101.0]), length=750.0)
