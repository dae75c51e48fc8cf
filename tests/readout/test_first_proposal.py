"""How wide the first proposal is, of densities whose width is known."""

from __future__ import annotations

import numpy as np
import pytest

from pmpnbp.geometry.poses import Array
from pmpnbp.readout.first_proposal import NARROW, WIDER, WIDER_EACH, measured_covariance
from pmpnbp.readout.importance_sampling import LogDensity

# Along axes that are no coordinates, metres, as many as a cabinet with two drawers has: all but the last are held by
# the curvature that the proposal comes from.
STDS = np.array([0.001, 0.004, *[0.002] * 5, 0.02])
AXES = np.linalg.qr(np.random.default_rng(0).standard_normal((8, 8)))[0]
COVARIANCE = (AXES * STDS**2) @ AXES.T


def widths(covariance: Array) -> Array:
    """Standard deviations along the axes, in those of the covariance that was started from."""
    found: Array = np.sqrt(np.einsum("ia,ij,ja->a", AXES, covariance, AXES)) / STDS
    return found


def gaussian(stds: Array) -> LogDensity:
    return lambda rows: -0.5 * ((rows @ AXES / stds) ** 2).sum(axis=1)


def test_it_stays_as_wide_as_a_gaussian_that_it_fits() -> None:
    np.testing.assert_allclose(widths(measured_covariance(gaussian(STDS), 0.0, COVARIANCE))[:-1], 1.0)


@pytest.mark.parametrize("narrower", [1e-6, 0.1, 0.25])
def test_it_is_narrower_where_the_density_is_and_never_too_narrow(narrower: float) -> None:
    for axis in range(2):
        stds = STDS.copy()
        stds[axis] *= narrower
        found = widths(measured_covariance(gaussian(stds), 0.0, COVARIANCE))
        assert max(narrower, np.sqrt(NARROW) * (1 - 1e-9)) <= found[axis] <= max(2 * np.sqrt(WIDER) * narrower, 0.5)
        np.testing.assert_allclose(found[1 - axis], 1.0)


@pytest.mark.parametrize("reach", [0.003, 0.02, 0.3])
def test_along_what_nothing_holds_it_is_as_wide_as_the_density(reach: float) -> None:
    """Of a box the standard deviation is its half over the root of three; it is looked at in steps of two."""

    def box(rows: Array) -> Array:
        inside = np.where(np.abs(rows @ AXES[:, -1]) < reach, 0.0, -np.inf)
        return inside + gaussian(np.array([*STDS[:-1], np.inf]))(rows)

    found = widths(measured_covariance(box, 0.0, COVARIANCE))[-1] * STDS[-1]
    assert 0.6 * reach / np.sqrt(3) < found < 1.7 * reach / np.sqrt(3)


def test_where_the_density_has_no_width_it_is_what_it_was() -> None:
    none = measured_covariance(lambda rows: np.full(len(rows), -np.inf), 0.0, COVARIANCE)
    assert np.isfinite(none).all() and np.linalg.eigvalsh(none).min() > 0


@pytest.mark.parametrize(("coordinates", "wider"), [(3, 1.0), (10, 10 * WIDER_EACH), (30, WIDER)])
def test_it_is_the_wider_the_more_coordinates_there_are(coordinates: int, wider: float) -> None:
    """Of a density three tenths as wide as the curvature has it."""

    def widened(count: int) -> float:
        def narrow(rows: Array) -> Array:
            return np.asarray(-0.5 * ((rows / 0.0003) ** 2).sum(axis=1))

        return float(np.diag(measured_covariance(narrow, 0.0, 0.001**2 * np.eye(count))).mean())

    np.testing.assert_allclose(widened(coordinates), wider * widened(1))
