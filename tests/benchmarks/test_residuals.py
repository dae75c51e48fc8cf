"""The study of residuals: its correlation against a slow twin, its Gaussian against draws, its skipping."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import residuals
from pmpnbp.geometry.camera import Camera
from pmpnbp.scene.normals import surface_normals
from pmpnbp.scene.observation import OBJECT, View


def test_correlation_is_the_mean_product_over_all_pairs(rng: np.random.Generator) -> None:
    image = rng.standard_normal((9, 30)) + 0.5
    image[rng.random(image.shape) < 0.3] = np.nan
    found = residuals.correlation(image)
    middle = residuals.FARTHEST
    square = np.nanmean(image**2)
    for down, across in ((0, 1), (3, 0), (2, -5), (-4, 12)):
        products = [
            image[row, column] * image[row + down, column + across]
            for row in range(9)
            for column in range(30)
            if 0 <= row + down < 9 and 0 <= column + across < 30
        ]
        assert found[middle + down, middle + across] == pytest.approx(np.nanmean(products) / square, abs=1e-9)
    assert found[middle, middle] == pytest.approx(1.0)


def test_an_offset_that_all_share_makes_all_pixels_say_the_same() -> None:
    assert residuals.correlation(np.full((40, 40), 0.003)).min() == pytest.approx(1.0)


def test_the_gaussian_is_that_of_draws(rng: np.random.Generator) -> None:
    """Each share is off by more than 5 standard errors once in two million."""
    edges = (0.0, 0.25, 0.5, 0.75, 1.0)
    draws = np.abs(rng.standard_normal(200_000)) / residuals.DEVIATIONS
    draws = draws[draws < 1.0]
    expected = residuals.core_shares(edges)
    shares = np.histogram(draws, edges)[0] / len(draws)
    assert np.all(np.abs(shares - expected) < 5 * np.sqrt(expected / len(draws)))


def test_the_tables_say_what_the_residuals_are(rng: np.random.Generator) -> None:
    image = 0.003 * rng.standard_normal((60, 80)) + 0.002
    image[:6] = 0.05
    image[6:9] = -0.05
    image[:, :10] = np.nan
    text = residuals.report({"white": (image, 0.012)})
    row = next(line for line in text.splitlines() if line.startswith("| white"))
    cells = [cell.strip() for cell in row.split("|")[1:-1]]
    assert cells[1:3] == [str(60 * 70), "85"]
    assert float(cells[3]) == pytest.approx(2.0, abs=0.3)
    assert float(cells[4]) == pytest.approx(3.0, abs=0.3)
    assert cells[5:7] == ["10", "5"]


def test_noise_is_told_by_the_slope_of_what_it_is_on(rng: np.random.Generator) -> None:
    """Planes turned away by 20, 50 and 75 degrees, 1, 2 and 4 mm of noise on them. A deviation by the median of 5,000
    values, each of them in few others, is off by an eighth once in a million."""
    camera = Camera(60, 50, 2000.0, 2000.0, 29.5, 24.5)
    x = camera.rays()[..., 0].astype(np.float64)
    for degrees, metres, bin in ((20, 0.001, 0), (50, 0.002, 2), (75, 0.004, 3)):
        plane = 1.0 / (1.0 - np.tan(np.deg2rad(degrees)) * x)
        noise = metres * rng.standard_normal(plane.shape)
        depth, category = (plane + noise).astype(np.float32), np.full(plane.shape, OBJECT, np.uint8)
        view = View(camera, depth, category, surface_normals(plane.astype(np.float32), camera))
        told = residuals.tangents(view)
        # a line of sight is 0.8 degrees from the middle one at the most
        assert told[1:-1, 1:-1] == pytest.approx(np.tan(np.deg2rad(degrees)), rel=0.08)
        own, rendered = residuals.by_slope(view, noise, 0.02)
        for values in (own, rendered):
            assert [len(one) > 2000 for one in values] == [k == bin for k in range(len(residuals.SLOPES) - 1)]
            assert np.median(np.abs(values[bin])) / 0.6745 == pytest.approx(metres, rel=0.125)
        row = residuals.slope_table({"a plane": (view, noise, 0.02)}).splitlines()[-1].split("|")
        assert float(row[2 + bin]) == pytest.approx(1000 * metres, rel=0.15)


def test_without_the_data_one_sentence_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    residuals.main([], data=tmp_path)
    assert "skipped, its data is not there" in capsys.readouterr().out
