"""The figure's geometry by its laws."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.reproduce.planar.pattern import (
    LENGTH,
    RADIUS,
    REACH,
    UPRIGHT,
    Hinge,
    Pattern,
    across,
    configuration,
    four_arms,
    hinge_frame,
    log_pairwise,
    wrap,
)
from benchmarks.reproduce.planar.picture import SIZE

FIGURE = four_arms()
EVERY_MESSAGE = range(FIGURE.messages)


def drawn_poses(seed: int, count: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform((0, 0, -np.pi), (SIZE, SIZE, np.pi), (count, 3))


def test_the_figure_is_a_tree_of_nine_nodes() -> None:
    assert (FIGURE.nodes, FIGURE.messages) == (9, 16)
    reached = {0}
    for hinge in FIGURE.hinges:
        assert hinge.parent in reached and hinge.child not in reached
        reached.add(hinge.child)
    assert reached == set(range(9))


def test_messages_feed_all_others_but_the_way_back() -> None:
    for message in EVERY_MESSAGE:
        back = message ^ 1
        assert (FIGURE.sender[message], FIGURE.receiver[message]) == (FIGURE.receiver[back], FIGURE.sender[back])
        senders = {int(FIGURE.sender[other]) for other in FIGURE.feeding[message]}
        neighbours = {int(FIGURE.sender[other]) for other in FIGURE.incoming[FIGURE.sender[message]]}
        assert senders == neighbours - {int(FIGURE.receiver[message])}


@pytest.mark.parametrize("seed", range(5))
def test_a_configuration_hangs_together_within_the_picture(seed: int) -> None:
    poses = configuration(np.random.default_rng(seed), FIGURE, SIZE)
    for message in EVERY_MESSAGE:
        ends = poses[FIGURE.sender[message]], poses[FIGURE.receiver[message]]
        assert log_pairwise(FIGURE, message, *ends, 1e-3, 1e-3) == pytest.approx(0.0, abs=1e-9)
    assert abs(poses[0, 2]) <= UPRIGHT
    assert np.all(np.hypot(*(poses[1:5, :2] - poses[0, :2]).T) <= RADIUS + LENGTH / 2 + 1e-9)
    assert np.all((poses[:, :2] > 0) & (poses[:, :2] < SIZE))
    assert REACH < SIZE / 2


@pytest.mark.parametrize("message", EVERY_MESSAGE)
def test_what_goes_across_fits_from_either_end(message: int) -> None:
    """Without noise every draw holds the hinge and stays within its limits, and ψ says the same in both directions."""
    poses = drawn_poses(message, 50)
    for to_sender in (True, False):
        other = across(np.random.default_rng(1), FIGURE, message, poses, to_sender, 1e-9, 1e-9)
        sender, receiver = (other, poses) if to_sender else (poses, other)
        there = log_pairwise(FIGURE, message, sender, receiver, 1e-3, 1e-3)
        np.testing.assert_allclose(there, 0.0, atol=1e-6)
        np.testing.assert_allclose(log_pairwise(FIGURE, message ^ 1, receiver, sender, 1e-3, 1e-3), there, atol=1e-12)


def test_across_a_locked_hinge_and_back_is_where_it_began() -> None:
    locked = Pattern((0, 1), (Hinge(0, 1, (3.0, 4.0), (-5.0, 1.0), 0.7, 0.0),))
    poses = drawn_poses(3, 50)
    rng = np.random.default_rng(2)
    there = across(rng, locked, 0, poses, False, 1e-12, 1e-12)
    back = across(rng, locked, 0, there, True, 1e-12, 1e-12)
    np.testing.assert_allclose(back[:, :2], poses[:, :2], atol=1e-8)
    np.testing.assert_allclose(wrap(back[:, 2] - poses[:, 2]), 0.0, atol=1e-8)


def test_potentials_do_not_depend_on_where_the_picture_begins() -> None:
    """Moving and turning both ends together changes nothing."""
    sender, receiver = drawn_poses(4, 20), drawn_poses(5, 20)
    turn, shift = 0.9, np.array([7.0, -11.0])
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def moved(poses: np.ndarray) -> np.ndarray:
        return np.column_stack([poses[:, :2] @ rotation.T + shift, poses[:, 2] + turn])

    for message in EVERY_MESSAGE:
        np.testing.assert_allclose(
            log_pairwise(FIGURE, message, moved(sender), moved(receiver), 5.0, 0.2),
            log_pairwise(FIGURE, message, sender, receiver, 5.0, 0.2),
            rtol=1e-9,
        )


@pytest.mark.parametrize("message", [0, 1])
def test_draws_across_are_distributed_as_the_potential(message: int) -> None:
    """The hinge's offset over sigma squared is exponential with mean 2, and the turn has the density of ψ: 20 bins of
    equal mass by each, chi-square with 19 degrees below 52.4, which chance exceeds once in 1e4 (scipy's chi2.isf)."""
    count, sigma, softness = 20_000, 4.0, 0.3
    pose = np.array([100.0, 120.0, 0.4])
    drawn = across(np.random.default_rng(6), FIGURE, message, np.tile(pose, (count, 1)), False, sigma, softness)
    ours = hinge_frame(FIGURE, message, pose, at_sender=True)
    theirs = hinge_frame(FIGURE, message, drawn, at_sender=False)
    squared = np.sum((theirs[:, :2] - ours[:2]) ** 2, axis=1) / sigma**2
    by_offset = np.exp(-squared / 2)  # uniform

    limit = FIGURE.hinges[0].limit
    turns = np.linspace(-np.pi, np.pi, 200_001)
    density = np.exp(-0.5 * (np.maximum(np.abs(turns) - limit, 0) / softness) ** 2)
    cumulative = np.cumsum(density) / density.sum()
    by_turn = np.interp(wrap(theirs[:, 2] - ours[2]), turns, cumulative)
    for uniform in (by_offset, by_turn):
        seen, _ = np.histogram(uniform, bins=20, range=(0.0, 1.0))
        assert np.sum((seen - count / 20) ** 2 / (count / 20)) < 52.4
