"""What the scan leaves open: against a posterior on a grid, on what is seen and on what is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import problem as problems
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import configuration_scores
from pmpnbp.readout import object_posterior
from pmpnbp.readout.object_posterior import CONFIDENCE, draw, link_covariances
from pmpnbp.readout.particle_statistics import covariance
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.prior import GaussianPrior, UniformPrior
from tests.inference import small_worlds as worlds

MODEL = worlds.cupboard()
ROOT, JOINTS = worlds.cupboard_truth()
SLIDE = 0


def looked_at(prior: UniformPrior | GaussianPrior, camera: Camera | None = None) -> Problem:
    observation = worlds.seen(MODEL, ROOT, JOINTS, camera)
    return problems.build(MODEL, observation, prior, worlds.settings(), particles=50)


def pinned() -> GaussianPrior:
    """The root to a hundredth of a millimetre, so that a joint's posterior is one along one line."""
    return GaussianPrior("link0", ROOT, np.full(3, 1e-5), np.full(3, 1e-5), {})


@pytest.mark.parametrize("name", ["seen", "hidden"])
def test_a_joint_s_posterior_is_that_on_a_grid(name: str) -> None:
    """The hinge is seen well, so that the slide's posterior is the score along it. Twenty sets of draws; of their mean
    and standard deviation five standard errors are tolerated: by Student's distribution with 19 degrees of freedom, one
    in ten thousand a comparison."""
    # from the front, and from low behind the closed back, where the drawer may be anywhere; every draw is rendered
    eye = (0.0, 0.0, 0.7) if name == "seen" else (2.9, -0.4, 0.3)
    made = looked_at(pinned(), worlds.camera_at(eye, ROOT[:3] + [0, 0, 0.2], width=64, height=48))
    fixed = replace(made, mrf=replace(made.mrf, model=frozen(made.mrf.model, JOINTS)))
    slide = np.linspace(0.0, 0.25, 2001)
    tried = np.tile(JOINTS, (len(slide), 1))
    tried[:, SLIDE] = slide
    log = CONFIDENCE * configuration_scores(made, np.tile(ROOT, (len(slide), 1)), tried, made.settings.tolerance_end)
    weights = np.exp(log - log.max())
    weights /= weights.sum()
    mean = weights @ slide
    std = np.sqrt(weights @ (slide - mean) ** 2)
    assert (std < 0.002) if name == "seen" else (std > 0.05)

    found = [draw(np.random.default_rng([4, k]), fixed, ROOT, JOINTS)[1][:, SLIDE] for k in range(20)]
    for measured, expected in ((np.mean(found, axis=1), mean), (np.std(found, axis=1), std)):
        assert abs(measured.mean() - expected) < 5 * measured.std(ddof=1) / np.sqrt(len(found)), (measured, expected)


def frozen(model: ArticulatedObject, joints: Array) -> ArticulatedObject:
    """The model with its hinge kept within a hundredth of a degree."""
    lower, upper = model.lower.copy(), model.upper.copy()
    lower[1], upper[1] = joints[1] - 1e-4, joints[1] + 1e-4
    return replace(model, lower=lower, upper=upper)


def test_draws_keep_to_the_limits_and_gather_where_the_truth_is() -> None:
    made = looked_at(UniformPrior("upright"))
    roots, joints = draw(np.random.default_rng(7), made, ROOT, JOINTS)
    assert roots.shape == (len(joints), 7) and len(joints) >= 1000
    np.testing.assert_allclose(np.linalg.norm(roots[:, 3:], axis=1), 1.0)
    assert np.all((joints >= MODEL.lower) & (joints <= MODEL.upper))
    offset = np.abs(roots[:, :3].mean(axis=0) - ROOT[:3])
    assert offset.max() < 0.003 and roots[:, :3].std(axis=0).max() < 0.003
    assert poses.rotation_angle(roots[:, 3:], ROOT[3:]).max() < 0.05


def test_covariances_are_those_of_the_draws_about_the_estimate(monkeypatch: pytest.MonkeyPatch) -> None:
    made = looked_at(UniformPrior("upright"))
    rng = np.random.default_rng(3)
    roots = poses.perturb(ROOT, 0.01 * rng.standard_normal((200, 3)), 0.02 * rng.standard_normal((200, 3)))
    joints = np.clip(JOINTS + 0.02 * rng.standard_normal((200, 2)), MODEL.lower, MODEL.upper)
    monkeypatch.setattr(object_posterior, "draw", lambda *_: (roots, joints))
    found = link_covariances(rng, made, ROOT, JOINTS)
    for row in range(len(MODEL.links)):
        one = np.array([MODEL.link_poses(MODEL.part_poses(r, q), q)[row] for r, q in zip(roots, joints, strict=True)])
        there = MODEL.link_poses(MODEL.part_poses(ROOT, JOINTS), JOINTS)[row]
        np.testing.assert_allclose(found[row], covariance(there, one, np.ones(200)), atol=1e-12)


def test_the_same_seed_gives_the_same_draws() -> None:
    made = looked_at(UniformPrior("upright"))
    once, again = (draw(np.random.default_rng(1), made, ROOT, JOINTS) for _ in range(2))
    for first, second in zip(once, again, strict=True):
        np.testing.assert_array_equal(first, second)
