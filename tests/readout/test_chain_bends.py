"""The motions of a chain that leave both its ends: what they move, and that draws go along them as far as is open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import mrf as fields
from pmpnbp.inference import problem as problems
from pmpnbp.readout.chain_bends import JOINTS, Bend, bends, bent, bent_otherwise, spread_along
from pmpnbp.readout.log_posterior import log_posterior
from pmpnbp.readout.object_posterior import misfit, mode_draws
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.prior import GaussianPrior
from tests.inference import small_worlds as worlds

COUNT, LENGTH = 6, 0.15
ROOT = worlds.at(0.4, -0.1, 0.3, 0.2, -0.4, 1.0)
# Not in a line, where a motion to one side is one to the other.
JOINTS_AT = np.array([0.3, -0.5, 0.4, 0.3, -0.6])


MODEL = worlds.hinged_chain(COUNT, LENGTH, flat=True)
MRF = fields.build(MODEL)


def motions(model: ArticulatedObject, root: Array, before: Array, after: Array) -> tuple[Array, Array]:
    """(N,) metres that each part's middle moves, and radians that it is turned by."""
    mrf = fields.build(model)
    one, other = mrf.part_poses(root, before), mrf.part_poses(root, after)
    middles = [poses.transform_points(parts, mrf.centres) for parts in (one, other)]
    return np.linalg.norm(middles[1] - middles[0], axis=1), poses.rotation_angle(one[:, 3:], other[:, 3:])


@pytest.mark.parametrize("length", [-0.02, -0.005, 0.005, 0.02])
def test_the_links_between_move_and_those_before_and_behind_stay(length: float) -> None:
    found = bends(MRF, ROOT, JOINTS_AT)
    assert [bend.coordinates for bend in found] == [(0, 1, 2, 3), (1, 2, 3, 4)]
    for bend in found:
        (after,) = bent(MRF, bend, ROOT[None], JOINTS_AT[None], np.array([length]))
        moved, turned = motions(MODEL, ROOT, JOINTS_AT, after)
        between = [1 + coordinate for coordinate in bend.coordinates[:-1]]
        rest = [node for node in range(COUNT) if node not in between]
        # a straight step of the joints would take the end along, by a share of the step that grows with it
        assert moved[rest].max() < 0.01 * abs(length) and turned[rest].max() < 0.01 * abs(length) / LENGTH
        far = np.sqrt((moved[between] ** 2 + (MRF.radii[between] * turned[between]) ** 2).sum())
        assert far == pytest.approx(abs(length), rel=0.02 + 10 * abs(length))


def test_what_has_no_four_joints_in_a_row_about_parallel_axes_has_none() -> None:
    followed = worlds.hinged_chain(JOINTS + 1, flat=True)
    mimic = replace(followed.edges[3], coordinates=followed.edges[0].coordinates)
    followed = replace(followed, edges=(*followed.edges[:3], mimic))
    for model in (
        worlds.star(5),
        worlds.cupboard(),
        worlds.hinged_chain(JOINTS, flat=True),
        worlds.hinged_chain(COUNT),
        followed,
    ):
        joints = np.clip(0.2 + 0.1 * np.arange(model.dof), model.lower, model.upper)
        assert bends(fields.build(model), ROOT, joints) == []


def along(bend: Bend, joints: Array) -> Array:
    """(K,) metres that joint vectors (K, D) are along a motion from JOINTS_AT, to the first order."""
    direction = bend.direction / (bend.direction @ bend.direction)
    found: Array = (joints - JOINTS_AT)[:, list(bend.coordinates)] @ direction
    return found


@pytest.mark.parametrize("std", [0.002, 0.006])
def test_the_spread_along_a_motion_is_that_of_a_gaussian(std: float) -> None:
    bend = bends(MRF, ROOT, JOINTS_AT)[0]
    found = spread_along(MRF, bend, ROOT, JOINTS_AT, lambda _, joints: -0.5 * (along(bend, joints) / std) ** 2)
    assert found == pytest.approx(std, rel=0.05)


def test_draws_go_as_far_along_a_motion_as_the_density_does() -> None:
    """4,000 draws: of the standard deviation six standard errors, a tenth in all, are tolerated; by the normal
    distribution a false alarm in 500 million."""
    count, std, narrow = 4000, 0.005, 1e-5
    bend = bends(MRF, ROOT, JOINTS_AT)[0]
    rng = np.random.default_rng(8)
    draws = np.tile(ROOT, (count, 1)), JOINTS_AT + narrow * rng.standard_normal((count, MODEL.dof))
    covariance = narrow**2 * np.eye(6 + MODEL.dof)

    def density(roots: Array, joints: Array) -> Array:
        """Wide along the first motion; the second moves the last joint, which is known."""
        return -0.5 * (along(bend, joints) / std) ** 2 - 0.5 * ((joints[:, 4] - JOINTS_AT[4]) / 1e-5) ** 2

    found = bent_otherwise(rng, MRF, bends(MRF, ROOT, JOINTS_AT), (ROOT, JOINTS_AT), covariance, draws, density)
    assert along(bend, found).std() == pytest.approx(std, rel=0.1)
    np.testing.assert_allclose(found[:, 4], JOINTS_AT[4], atol=1e-3)
    # what is as wide already stays, bit for bit
    wide = bent_otherwise(
        rng, MRF, bends(MRF, ROOT, JOINTS_AT), (ROOT, JOINTS_AT), np.eye(6 + MODEL.dof), draws, density
    )
    np.testing.assert_array_equal(wide, draws[1])


def test_what_cannot_be_bent_so_far_stays_as_it_was(rng: np.random.Generator) -> None:
    """Links of 4 cm and a motion that nothing tells for 4 cm and more: many a draw would have to go where the links do
    not reach."""
    short = worlds.hinged_chain(COUNT, 0.04, flat=True)
    mrf, draws = fields.build(short), (np.tile(ROOT, (400, 1)), np.tile(JOINTS_AT, (400, 1)))
    motions_there = bends(mrf, ROOT, JOINTS_AT)
    found = bent_otherwise(
        rng, mrf, motions_there, (ROOT, JOINTS_AT), 1e-8 * np.eye(6 + short.dof), draws, lambda _, q: np.zeros(len(q))
    )
    ends = mrf.part_poses(draws[0], found)[:, -1]
    gap = np.linalg.norm(ends[:, :3] - mrf.part_poses(ROOT[None], JOINTS_AT[None])[0, -1, :3], axis=1)
    assert motions_there and np.abs(found - JOINTS_AT).max() > 0.2
    assert gap.max() < 0.03


def test_limits_are_kept() -> None:
    bend = bends(MRF, ROOT, JOINTS_AT)[0]
    at_limit = np.array([1.2, -1.2, 0.4, 0.3, -0.6])
    found = bent(MRF, bend, np.tile(ROOT, (21, 1)), np.tile(at_limit, (21, 1)), np.linspace(-0.05, 0.05, 21))
    assert np.all((found >= MODEL.lower) & (found <= MODEL.upper))


def test_a_chain_s_draws_are_as_wide_as_its_posterior_along_each_motion() -> None:
    """Its covariance alone would be narrower: that of draws which no round has led along the curve."""
    root = worlds.at(-0.1, 0.0, 0.6, 0.0, 1.4, 0.0)
    made = problems.build(
        MODEL,
        worlds.seen(MODEL, root, JOINTS_AT),
        GaussianPrior("link0", root, np.full(3, 1e-4), np.full(3, 1e-4), {}),
        worlds.settings(),
        particles=50,
    )
    draws = mode_draws(np.random.default_rng(3), made, root, JOINTS_AT)
    weights = np.exp(draws.log_weights)
    found = bends(made.mrf, root, JOINTS_AT)
    assert found
    height = misfit(float(log_posterior(made, root[None], JOINTS_AT[None])[0]))
    for bend in found:
        wide = spread_along(
            made.mrf, bend, root, JOINTS_AT, lambda *at, height=height: log_posterior(made, *at) / height
        )
        gap = along(bend, draws.joints) - weights @ along(bend, draws.joints)
        assert np.sqrt(weights @ gap**2) > 0.7 * wide
