"""What the scan leaves open: against a posterior on a grid, on what is seen and on what is not; and the modes of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import problem as problems
from pmpnbp.inference.held_part import Held
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import configuration_scores
from pmpnbp.readout import first_proposal, log_posterior
from pmpnbp.readout.first_proposal import CELLS, STRIDE
from pmpnbp.readout.image_grain import grain
from pmpnbp.readout.object_posterior import ModeDraws, drawn_nuisance_stds, mode_draws
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.depth_noise import SHARED
from pmpnbp.scene.prior import GaussianPrior, UniformPrior
from tests.inference import small_worlds as worlds

MODEL = worlds.cupboard()
ROOT, JOINTS = worlds.cupboard_truth()
SLIDE = 0


def looked_at(prior: UniformPrior | GaussianPrior, camera: Camera | None = None, **settings: float) -> Problem:
    observation = worlds.seen(MODEL, ROOT, JOINTS, camera)
    return problems.build(MODEL, observation, prior, worlds.settings(**settings), particles=50)


def pinned() -> GaussianPrior:
    """The root to a hundredth of a millimetre, so that a joint's posterior is one along one line."""
    return GaussianPrior("link0", ROOT, np.full(3, 1e-5), np.full(3, 1e-5), {})


def moments(draws: ModeDraws) -> tuple[float, float]:
    """Mean and standard deviation of the slide."""
    weights, slide = np.exp(draws.log_weights), draws.joints[:, SLIDE]
    mean = float(weights @ slide)
    return mean, float(np.sqrt(weights @ (slide - mean) ** 2))


def test_what_has_no_joints_has_a_posterior() -> None:
    model = worlds.articulated([], {"link0": worlds.block([0.3, 0.2, 0.1])})
    made = problems.build(model, worlds.seen(model, ROOT, np.zeros(0)), UniformPrior("upright"), worlds.settings())
    draws = mode_draws(np.random.default_rng(0), made, ROOT, np.zeros(0))
    assert draws.joints.shape == (len(draws.roots), 0) and draws.elsewhere.roots.shape == (0, 7)
    assert draws.held_stds.max() < 0.01


@pytest.mark.parametrize(("name", "longest"), [("seen", 0.25), ("hidden", 0.25), ("hidden", 0.07)])
def test_a_joint_s_posterior_is_that_on_a_grid(name: str, longest: float) -> None:
    """The hinge is known, so that the slide's posterior is the score along it. Twenty sets of draws; of their mean and
    standard deviation five standard errors are tolerated: by Student's distribution with 19 degrees of freedom, one in
    ten thousand a comparison."""
    # from the front, and from low behind the closed back, where the drawer may be anywhere; every draw is rendered
    eye = (0.0, 0.0, 0.7) if name == "seen" else (2.9, -0.4, 0.3)
    made = looked_at(pinned(), worlds.camera_at(eye, ROOT[:3] + [0, 0, 0.2], width=64, height=48))
    fixed = replace(made, mrf=replace(made.mrf, model=frozen(made.mrf.model, JOINTS, longest)))
    at = np.minimum(JOINTS, fixed.mrf.model.upper)
    slide = np.linspace(0.0, longest, 2001)
    tried = np.tile(at, (len(slide), 1))
    tried[:, SLIDE] = slide
    score = configuration_scores(made, np.tile(ROOT, (len(slide), 1)), tried, made.settings.tolerance_end)
    log = log_posterior.confidence(made) * score
    weights = np.exp(log - log.max())
    weights /= weights.sum()
    mean = weights @ slide
    std = np.sqrt(weights @ (slide - mean) ** 2)
    assert (std < 0.002) if name == "seen" else (std > 0.2 * longest)
    # and what the image's grain hides besides, of a root that is known to a hundredth of a millimetre
    hidden, known = grain(fixed, Held(fixed.mrf, 0, ROOT, at)), np.diag(np.full(6, 1e-5**2))
    tied = np.linalg.solve(hidden[:6, :6] + known, hidden[:6, 6 + SLIDE])
    std = np.hypot(std, np.sqrt(hidden[6 + SLIDE, 6 + SLIDE] - hidden[6 + SLIDE, :6] @ tied))

    found = np.array([moments(mode_draws(np.random.default_rng([4, k]), fixed, ROOT, at)) for k in range(20)])
    for measured, expected in zip(found.T, (mean, std), strict=True):
        assert abs(measured.mean() - expected) < 5 * measured.std(ddof=1) / np.sqrt(len(found)), (measured, expected)


def test_a_pixel_counts_less_where_many_err_as_one() -> None:
    """By hand: the variance of its Gaussian is the floor's and the noise's, times what the scan tells of how many."""
    made = looked_at(pinned())
    for noise, area, times in ((0.005, 1.0, SHARED), (0.005, 9.0, 3.0), (0.005, 2.0, np.sqrt(2.0))):
        given = replace(made, noise=np.array([noise]), noise_area=np.array([area]))
        variance = log_posterior.FLOOR**2 + (times * noise) ** 2
        assert log_posterior.confidence(given) == pytest.approx(made.tolerance_end**2 / 2 / variance)


def frozen(model: ArticulatedObject, joints: Array, longest: float) -> ArticulatedObject:
    """The model with its slide so long, metres, and its hinge kept within a hundredth of a degree."""
    lower, upper = model.lower.copy(), model.upper.copy()
    upper[SLIDE] = longest
    lower[1], upper[1] = joints[1] - 1e-4, joints[1] + 1e-4
    return replace(model, lower=lower, upper=upper)


@pytest.mark.parametrize("name", ["seen", "hidden"])
def test_cells_that_are_not_looked_at_would_change_nothing(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    eye = (0.0, 0.0, 0.7) if name == "seen" else (2.9, -0.4, 0.3)
    made = looked_at(pinned(), worlds.camera_at(eye, ROOT[:3] + [0, 0, 0.2], width=64, height=48))
    rendered: list[int] = []
    real = log_posterior.object_scores

    def counted(*arguments: Any) -> Array:
        rendered[-1] += len(arguments[2])
        return real(*arguments)

    monkeypatch.setattr(log_posterior, "object_scores", counted)
    draws = []
    for hopeless in (first_proposal.HOPELESS, np.inf):
        monkeypatch.setattr(first_proposal, "HOPELESS", hopeless)
        rendered.append(0)
        draws.append(mode_draws(np.random.default_rng(2), made, ROOT, JOINTS))
    assert len(draws[0].elsewhere.roots) <= len(draws[1].elsewhere.roots)
    for member in set(vars(draws[0])) - {"about", "elsewhere"}:
        np.testing.assert_array_equal(getattr(draws[0], member), getattr(draws[1], member))
    # of both joints, where they are in sight
    assert rendered[1] - rendered[0] == (2 * (CELLS - CELLS // STRIDE) if name == "seen" else 0)


def test_draws_keep_to_the_limits_and_gather_where_the_truth_is() -> None:
    made = looked_at(UniformPrior("upright"))
    draws = mode_draws(np.random.default_rng(7), made, ROOT, JOINTS)
    weights = np.exp(draws.log_weights)
    assert draws.roots.shape == (len(draws.joints), 7) and weights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(np.linalg.norm(draws.roots[:, 3:], axis=1), 1.0)
    assert np.all((draws.joints >= MODEL.lower) & (draws.joints <= MODEL.upper))
    offset = draws.roots[:, :3] - ROOT[:3]
    assert np.abs(weights @ offset).max() < 0.003 and np.sqrt(weights @ offset**2).max() < 0.004
    assert weights @ poses.rotation_angle(draws.roots[:, 3:], ROOT[3:]) < 0.01
    assert 20 < draws.effective_sample_size <= len(weights)


def test_the_evidence_is_the_same_from_any_seed_and_falls_where_the_object_is_not() -> None:
    """From one set of draws to the next it has a deviation of 0.3 nats; over twenty sets 0.6 would be found once in ten
    million times (chi-square, 19 degrees of freedom)."""
    made = looked_at(UniformPrior("upright"))
    here = [mode_draws(np.random.default_rng(k), made, ROOT, JOINTS).log_evidence for k in range(20)]
    assert np.std(here, ddof=1) < 0.6
    away = np.concatenate([ROOT[:3] + [0.0, 0.02, 0.0], ROOT[3:]])
    away_joints = np.clip(JOINTS + [0.05, 0.1], MODEL.lower, MODEL.upper)
    apart = looked_at(GaussianPrior("link0", away, np.full(3, 1e-4), np.full(3, 1e-4), {}))
    assert mode_draws(np.random.default_rng(0), apart, away, away_joints).log_evidence < min(here) - 5


def test_the_same_seed_gives_the_same_draws() -> None:
    made = looked_at(UniformPrior("upright"))
    once, again = (mode_draws(np.random.default_rng(1), made, ROOT, JOINTS) for _ in range(2))
    for name in ("roots", "joints", "log_weights"):
        np.testing.assert_array_equal(getattr(once, name), getattr(again, name))
    assert once.log_evidence == again.log_evidence


def test_what_is_known_beforehand_stays_known() -> None:
    """However coarse the image: the root to a hundredth of a millimetre, and the slide."""
    prior = GaussianPrior("link0", ROOT, np.full(3, 1e-5), np.full(3, 1e-5), {"slide": (float(JOINTS[SLIDE]), 1e-5)})
    made = looked_at(prior)
    draws = mode_draws(np.random.default_rng(0), made, ROOT, JOINTS)
    weights = np.exp(draws.log_weights)
    moves, turns = poses.perturbation(ROOT, draws.roots, np.zeros(3))
    apart = np.concatenate([moves, turns, draws.joints[:, [SLIDE]] - JOINTS[SLIDE]], axis=1)
    # what the prior says of each, once by the draws and once at most by what the image hides
    assert np.all(weights @ apart**2 < 2.5 * 1e-5**2)
    loose = mode_draws(np.random.default_rng(0), looked_at(UniformPrior("upright")), ROOT, JOINTS)
    moves, _ = poses.perturbation(ROOT, loose.roots, np.zeros(3))
    assert np.any(np.exp(loose.log_weights) @ moves**2 > 10 * 1e-5**2)


def test_sizes_are_off_with_the_rest_by_what_outlines_have_wrong() -> None:
    """The draws of sizes are as wide as the image's grain leaves them, at least, less what chance makes of their
    deviation: of fifty draws that count a deviation is less than half of what it is once in 10^9 times."""
    made = looked_at(UniformPrior("upright"), size_std=0.02)
    found = mode_draws(np.random.default_rng(3), made, ROOT, JOINTS)
    hidden, stds = np.sqrt(np.diag(grain(made, found.about)))[-3:], drawn_nuisance_stds(made, found)
    assert stds is not None and found.middle_nuisances is not None and hidden.min() > 5e-4
    assert np.all(stds[-3:] > 0.5 * hidden) and not stds[:-3].any()
    assert np.all(np.abs(found.middle_nuisances[-3:]) < 4 * stds[-3:])
