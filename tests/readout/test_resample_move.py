"""Draws that are moved on are of the density, wherever they start; steps let go of one part at a time.

False-alarm rates: as in `test_importance_sampling`, means over many sets with seeds of their own are compared with
exact moments in standard errors, of which five are tolerated: less than two in a hundred thousand a comparison.
"""

from __future__ import annotations

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import mrf as fields
from pmpnbp.readout.importance_sampling import WeightedDraws
from pmpnbp.readout.resample_move import FORGOTTEN, HELD, LOOSE, ROUNDS, WALKERS, moved_on, steps_of_parts
from tests.inference import small_worlds as worlds

SETS, TOLERATED = 40, 5.0
BEND = 0.7


def bent(rows: Array) -> Array:
    """Along a parabola: x is a standard Gaussian, y one of a third of its width about BEND (x^2 - 1); z is what it is
    anyhow."""
    x, y = rows[:, 0], rows[:, 1]
    return -0.5 * (x**2 + ((y - BEND * (x**2 - 1)) / 0.3) ** 2)


def start(rows: Array, log_weights: Array) -> WeightedDraws:
    return WeightedDraws(rows, bent(rows), log_weights, -1.25, 7.0)


@pytest.mark.parametrize("power", [1.0, 0.5])
def test_draws_of_a_bent_density_stay_of_it(power: float) -> None:
    """To a power the density is as much wider: x has the variance 1 / power. Half of the draws that it starts from have
    no weight. Steps are a chord along the bend, which is hardly taken, and short ones."""
    covariances = np.array([np.diag([1.0, 0.3]) ** 2, np.diag([0.3, 0.3]) ** 2])
    with np.errstate(divide="ignore"):
        log_weights = np.log(np.repeat([1 / WALKERS, 0.0], WALKERS))
    found = []
    for seed in range(SETS):
        rng = np.random.default_rng([5, seed])
        x, off = rng.standard_normal((2, 2 * WALKERS)) * np.array([[1.0], [0.3]]) / np.sqrt(power)
        rows = np.stack([x, BEND * (x**2 - 1) + off, np.arange(2.0 * WALKERS)], axis=1)
        made = moved_on(rng, bent, start(rows, log_weights), covariances, power)
        x, y, z = made.rows.T
        off = y - BEND * (x**2 - 1)
        found.append([x.mean(), (x**2).mean(), off.mean(), (off**2).mean(), z.mean()])
        np.testing.assert_array_equal(made.log_density, bent(made.rows))
        assert made.log_integral == -1.25 and made.effective_sample_size == 7.0
        np.testing.assert_allclose(np.exp(made.log_weights), 1 / (WALKERS * (ROUNDS - FORGOTTEN)))
    means, spread = np.mean(found, axis=0), np.std(found, axis=0, ddof=1)
    exact = np.array([0.0, 1 / power, 0.0, 0.09 / power, (WALKERS - 1) / 2])
    assert np.all(np.abs(means - exact) <= TOLERATED * spread / np.sqrt(SETS) + 1e-9), (means, exact)


def test_draws_go_where_importance_sampling_had_none() -> None:
    """From one place at the bend's tip, a standard deviation of x of more than a third of its own."""
    rows = np.array([[0.0, -BEND]])
    made = moved_on(np.random.default_rng(0), bent, start(rows, np.zeros(1)), np.array([np.diag([0.3, 0.3]) ** 2]), 1.0)
    assert made.rows[:, 0].std() > 1 / 3


def test_a_draw_of_no_weight_leaves_nothing_behind() -> None:
    rows = np.array([[0.0, -BEND], [50.0, 50.0]])
    with np.errstate(divide="ignore"):
        drawn = start(rows, np.log([1.0, 0.0]))
    made = moved_on(np.random.default_rng(1), bent, drawn, np.zeros((1, 2, 2)), 1.0)
    np.testing.assert_array_equal(made.rows, np.tile(rows[0], (len(made.rows), 1)))


def test_where_the_density_ends_no_draw_goes() -> None:
    def half(rows: Array) -> Array:
        return np.where(rows[:, 0] >= 0, -rows[:, 0], -np.inf)

    drawn = WeightedDraws(np.ones((1, 1)), -np.ones(1), np.zeros(1), 0.0, 1.0)
    made = moved_on(np.random.default_rng(2), half, drawn, np.ones((1, 1, 1)), 1.0)
    assert made.rows.min() >= 0 and made.rows.max() > 1


def test_a_step_lets_one_part_loose() -> None:
    """Of a chain whose links can go where they like, as each is held by two joints only, its neighbours follow."""
    model = worlds.hinged_chain(12)
    mrf, nodes = fields.build(model), len(model.parts)
    joints = np.full(model.dof, 0.1)
    found = steps_of_parts(mrf, worlds.at(), joints)
    assert found.shape == (nodes + 1, 6 + model.dof, 6 + model.dof)
    spread = np.array([spreads(mrf, joints, covariance) for covariance in found])
    for node in range(nodes):
        assert (spread[node] / spread[-1]).argmax() in range(node - 1, node + 2)
        far = np.abs(np.arange(nodes) - node) > 3
        np.testing.assert_allclose(spread[node, far], spread[-1, far], rtol=0.15)
    farther = np.diag(spread) / spread[-1]
    assert farther.min() > 1.05 and farther.mean() > 1.3
    assert spread.max() < LOOSE and np.all(spread[-1] < 1.01 * HELD)


def spreads(mrf: fields.Mrf, joints: Array, covariance: Array) -> Array:
    """(N,) root mean square by which each part's middle moves in a step, drawn small and scaled."""
    draws = 1e-3 * np.random.default_rng(3).multivariate_normal(np.zeros(len(covariance)), covariance, 4000)
    roots = poses.perturb(worlds.at(), draws[:, :3], draws[:, 3:6], mrf.centres[0])
    moved = poses.transform_points(mrf.part_poses(roots, joints + draws[:, 6:]), mrf.centres)
    here = poses.transform_points(mrf.part_poses(worlds.at(), joints), mrf.centres)
    # along one axis, as HELD and LOOSE are
    found: Array = 1e3 * np.sqrt(((moved - here) ** 2).mean(axis=(0, 2)))
    return found
