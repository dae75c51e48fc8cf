"""Grown chains: they keep to their joints, reach what a greedy walk misses, and explain nothing twice."""

from __future__ import annotations

from collections import Counter
from copy import deepcopy
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import chain_growth, hypotheses, initialisation, problem, run
from pmpnbp.inference.belief import SURFACE
from pmpnbp.inference.hypotheses import SEARCH_POINTS, Proposals
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.surfaces import prepare_surfaces
from pmpnbp.potentials.unary import object_scores
from pmpnbp.readout.metrics import add, model_points
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.settings import schedule
from tests.inference import small_worlds as worlds
from tests.inference.test_search import MODELS

TARGET = worlds.hinged_chain(4).part_poses(worlds.at(), np.array([-1.0, 0.3, -0.8]))[3, :3]


def proposals(rng: np.random.Generator, made: Problem, roots: Array) -> Proposals:
    return Proposals(
        roots=roots,
        joints=initialisation.random_joints(rng, made, len(roots)),
        source=np.full(len(roots), SURFACE, dtype=np.uint8),
        ancestor=np.full(len(roots), -1, dtype=np.int32),
        held=np.zeros(len(roots), dtype=np.int64),
    )


@pytest.fixture
def sharing_no_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the unary potential is a formula and no picture, parts explain together what they explain alone."""

    def explained_together(problem: Problem, part_poses: Array, placed: set[int], tolerance: float) -> Array:
        found: Array = problem.unary(np.arange(part_poses.shape[1]), part_poses, tolerance, "splats")[:, sorted(placed)]
        return found.sum(axis=1)

    monkeypatch.setattr(chain_growth, "explained_together", explained_together)
    # nor is there a scan to be laid on
    monkeypatch.setattr(chain_growth, "LAID_EVERY", 10**9)
    monkeypatch.setattr(chain_growth, "_laid_on_the_scan", lambda rng, problem, chains, placed, plan: chains)


def misleading(node: Array, part_poses: Array) -> Array:
    """Log unary: the first link likes to lean to one side, the last one to be near a target on the other."""
    to_target = np.linalg.norm(part_poses[..., :3] - TARGET, axis=-1)
    return np.where(node == 1, 3.0 * poses.rotate(part_poses[..., 3:], worlds.Z)[..., 0], 0.0) - np.where(
        node == 3, 50.0 * to_target, 0.0
    )


@pytest.mark.usefixtures("sharing_no_pixels")
@pytest.mark.parametrize("name", MODELS)
def test_growing_puts_every_part_where_the_joints_say(rng: np.random.Generator, name: str) -> None:
    model = MODELS[name]
    made = worlds.given_unary(model, misleading, worlds.settings())
    roots = np.concatenate([rng.uniform(-1, 1, (6, 3)), poses.random_quaternions(rng, (6,))], axis=-1)
    lineage = np.repeat(np.arange(3), 2)
    chains, score = chain_growth.grown(rng, made, proposals(rng, made, roots), lineage, schedule(made.settings, 1))
    assert np.all((chains.joints >= model.lower - 1e-9) & (chains.joints <= model.upper + 1e-9))
    again = model.part_poses(chains.roots, chains.joints)
    np.testing.assert_allclose(chains.part_poses[..., :3], again[..., :3], atol=1e-9)
    assert poses.rotation_angle(chains.part_poses[..., 3:], again[..., 3:]).max() < 1e-7
    nodes = np.arange(len(model.parts))
    np.testing.assert_allclose(chains.unary, misleading(nodes, chains.part_poses), atol=1e-9)
    np.testing.assert_allclose(score, chains.unary.sum(axis=1), atol=1e-9)


@pytest.mark.usefixtures("sharing_no_pixels")
def test_it_finds_the_best_of_all_positions_where_a_walk_does_not(rng: np.random.Generator) -> None:
    """Two links end in fewer places than CHAINS, so that nothing may be lost."""
    model = worlds.hinged_chain(4)
    made = worlds.given_unary(model, misleading, worlds.settings())
    root = worlds.at()[None]
    strata = (np.arange(chain_growth.DRAWS) + 0.5) / chain_growth.DRAWS
    every = model.lower + np.array(list(product(strata, repeat=3))) * (model.upper - model.lower)
    exhaustive = misleading(np.arange(4), model.part_poses(np.tile(root, (len(every), 1)), every)).sum(axis=1).max()
    lineage, plan = np.zeros(1, dtype=np.int64), schedule(made.settings, 1)
    chains, _ = chain_growth.grown(rng, made, proposals(rng, made, root), lineage, plan)
    assert len(chains.roots) <= chain_growth.CHAINS + chain_growth.LAID
    walked = hypotheses.walk(rng, made, proposals(rng, made, np.tile(root, (300, 1))), schedule(made.settings, 1))
    # a position is a random one of its stratum, and moves the last link by as much as 2 cm
    assert chains.unary.sum(axis=1).max() > exhaustive - 2.0
    assert walked.unary.sum(axis=1).max() < exhaustive - 4.0


def test_of_those_that_end_alike_the_best_goes_on(rng: np.random.Generator) -> None:
    score, ends, lineage = rng.standard_normal(200), rng.integers(40, size=200), rng.integers(3, size=200)
    ends = 3 * ends + lineage
    expected, alike, room = [], set(), {0: 8, 1: 8, 2: 8}
    for row in sorted(range(200), key=lambda row: -score[row]):
        if ends[row] not in alike and room[lineage[row]]:
            expected.append(row)
            room[lineage[row]] -= 1
        alike.add(ends[row])
    assert chain_growth._best_of_each(score, ends, lineage, 8).tolist() == expected


def snake(count: int) -> ArticulatedObject:
    """A block with `count` bars in a row behind it, 7 cm each, and a larger last one."""
    bars = worlds.hinged_chain(count + 1, 0.07)
    foot, bar = (
        worlds.block([0.2, 0.14, 0.08], worlds.at(0.02, z=0.03)),
        worlds.block([0.04, 0.03, 0.07], worlds.at(z=0.035)),
    )
    surfaces = {f"link{k}": bar for k in range(1, count)} | {"link0": foot}
    return worlds.articulated(list(bars.joints), surfaces | {f"link{count}": worlds.block([0.12, 0.09, 0.05])})


def test_chains_that_end_in_one_region_leave_room_for_others(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two hundred good ends in one spot, which a lineage has room for, and some worse ones elsewhere."""
    monkeypatch.setattr(chain_growth, "CROWDED", 1.0)
    monkeypatch.setattr(chain_growth, "CHAINS", 30)
    mrf = worlds.given_unary(worlds.hinged_chain(4), misleading, worlds.settings()).mrf
    tried = np.tile(worlds.at(), (240, 1))
    tried[:200, :3] += rng.uniform(-0.002, 0.002, (200, 3))
    tried[200:, :3] += np.arange(1, 41)[:, None] * [0.5, 0.0, 0.0]
    total, lineage = rng.permutation(240) / 240 + (np.arange(240) < 200), np.repeat([0, 1], 120)
    lineage[200:] = np.tile([0, 1], 20)
    region = chain_growth._cells(deepcopy(rng), mrf, 3, tried, chain_growth.REGION)
    chosen = chain_growth._going_on(rng, mrf, 3, tried, total, np.arange(240), lineage)
    merit, better, room = total.copy(), Counter[tuple[int, int]](), {0: 30, 1: 30}
    for row in sorted(range(240), key=lambda row: -total[row]):
        where = int(region[row]), int(lineage[row])
        merit[row] -= total.max() * better[where]
        better[where] += 1
    expected = []
    for row in sorted(range(240), key=lambda row: -merit[row]):
        if room[lineage[row]]:
            expected.append(row)
            room[lineage[row]] -= 1
    assert chosen.tolist() == expected
    for number in (0, 1):
        own = chosen[lineage[chosen] == number]
        # a spot lies in one cell or on the border of a few; all ends elsewhere had room
        assert 5 <= np.sum(own < 200) <= 10 and np.sum(own >= 200) == 20
        best = np.flatnonzero((lineage == number) & (np.arange(240) < 200))
        assert own[0] == best[total[best].argmax()]


def test_links_explain_a_pixel_once_and_those_without_a_place_none(rng: np.random.Generator) -> None:
    """Against an object that ends with the last link that has a place."""
    model, root = snake(6), worlds.at(1.6, 0.1, 0.0, yaw=2.6)
    observation = worlds.seen(model, root, np.array([0.3, 0.2, -0.35, 0.15, 0.3, 0.1]))
    made = problem.build(model, observation, UniformPrior("upright"), worlds.settings(), particles=50)
    part_poses = model.part_poses(root, rng.uniform(model.lower, model.upper, (30, model.dof)))
    part_poses[0, 3] = part_poses[0, 2]
    for count in range(1, 7):
        shorter = prepare_surfaces(replace(model, parts=model.parts[:count], edges=model.edges[: count - 1]))
        expected = object_scores(
            observation, shorter, part_poses[:, :count], replace(made.plain_score(0.03), continued_reward=1.0)
        )
        wherever = part_poses.copy()
        wherever[:, count:] = 0.0
        found = chain_growth.explained_together(made, wherever, set(range(count)), 0.03)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    both, one = (chain_growth.explained_together(made, part_poses[:1], placed, 0.03) for placed in ({2, 3}, {2}))
    alone = made.unary(np.arange(2, 4), part_poses[0, 2:4], 0.03, "rasteriser")
    np.testing.assert_allclose([both[0], one[0], alone.sum() / 2], alone[0], rtol=1e-6)


def test_laid_on_the_scan_what_is_placed_comes_nearer_to_its_place(rng: np.random.Generator) -> None:
    """The root's turn with it, of which the first links say little and the far ones much."""
    model, root, joints = snake(6), worlds.at(1.6, 0.1, 0.0, yaw=2.6), np.array([1.2, 0.2, -0.35, 0.15, 0.3, 0.1])
    observation = worlds.seen(model, root, joints)
    made = problem.build(model, observation, UniformPrior("upright"), worlds.settings(), particles=50)
    yaw = np.linspace(-0.12, 0.12, 7)[:, None]
    roots = poses.perturb(np.tile(root, (7, 1)), np.zeros((7, 3)), yaw * observation.up)
    placed, truth, wrong = set(range(6)), model.part_poses(root, joints), np.append(joints[:5], -1.1)
    starts = replace(proposals(rng, made, roots), joints=np.tile(wrong, (7, 1)))
    before = hypotheses.Hypotheses(**vars(starts), unary=np.zeros((7, 7)), part_poses=model.part_poses(roots, wrong))
    plan = replace(schedule(made.settings, 1), tolerance=0.03)
    after = chain_growth._laid_on_the_scan(rng, made, before, placed, plan)
    score = [chain_growth.explained_together(made, each.part_poses, placed, 0.03) for each in (before, after)]
    assert np.all(score[1] >= score[0]) and np.all(score[0].max() - score[1] <= 0.6 * (score[0].max() - score[0]))
    off = [np.linalg.norm(each.part_poses[:, 5, :3] - truth[5, :3], axis=1) for each in (before, after)]
    assert off[0].max() > 0.02 and np.all(off[1] <= off[0] + 0.001) and off[1].mean() < 0.7 * off[0].mean()
    np.testing.assert_allclose(after.part_poses, model.part_poses(after.roots, after.joints), atol=1e-12)
    alone = made.unary(
        np.tile(np.arange(6, dtype=np.int32), 7), after.part_poses[:, :6].reshape(-1, 7), 0.03, "splats", SEARCH_POINTS
    )
    np.testing.assert_allclose(after.unary[:, :6].ravel(), alone)
    # the last link has no place, and is not drawn to where it is seen
    assert np.all(after.unary[:, 6] == 0.0) and np.allclose(after.joints[:, 5], -1.1, atol=1e-6)


def test_a_prior_of_the_root_counts_once(rng: np.random.Generator) -> None:
    """Not in the link's own log unary, to which it is added of whole chains."""
    model, root = snake(3), worlds.at(1.6, 0.1, 0.0, yaw=2.6)
    observation = worlds.seen(model, root, np.array([0.3, 0.2, -0.35]))
    prior = worlds.rough_prior(rng, root)
    known, unknown = (
        problem.build(model, observation, each, worlds.settings(), particles=50)
        for each in (prior, UniformPrior("upright"))
    )
    roots = poses.perturb(np.tile(root, (5, 1)), rng.normal(0, 0.01, (5, 3)), np.zeros((5, 3)))
    plan = replace(schedule(known.settings, 1), tolerance=0.03)
    chains, _ = chain_growth.grown(rng, known, proposals(rng, known, roots), np.arange(5), plan)
    alone = unknown.unary(np.zeros(len(chains.roots), dtype=np.int32), chains.roots, 0.03, "splats", SEARCH_POINTS)
    np.testing.assert_allclose(chains.unary[:, 0], alone)
    part_poses = model.part_poses(roots, np.zeros((5, model.dof)))
    each = (chain_growth.explained_together(made, part_poses, {0, 1}, 0.03) for made in (known, unknown))
    np.testing.assert_allclose(np.subtract(*each), known.log_prior(part_poses[:, 0]))


def test_a_long_chain_is_found_in_one_iteration() -> None:
    model = snake(problem.LONG_CHAIN)
    root, joints = worlds.at(1.6, 0.1, 0.0, yaw=2.6), np.tile([0.3, 0.2, -0.35, 0.15], 4)[: model.dof]
    observation = worlds.seen(model, root, joints)
    hurried = worlds.settings(search_proposals=1000, search_islands=4)
    made = problem.build(model, observation, UniformPrior("upright"), hurried, particles=100)
    assert made.grows and made.search_iterations == 1
    report = list(run.iterate(replace(made, seed=1), 1))[-1]
    truth = model.part_poses(root, joints)
    errors = [
        add(model_points(part.mesh), pose, true)
        for part, pose, true in zip(model.parts, report.map_poses, truth, strict=True)
    ]
    assert np.mean(np.array(errors) < 0.02) >= 0.9
