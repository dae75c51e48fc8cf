"""How much of what should be seen a scan confirms, counted pixel by pixel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from pmpnbp.inference import problem as problems
from pmpnbp.inference.confirmation import confirmation
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.unary import render
from pmpnbp.scene.articulated_object import Joint
from pmpnbp.scene.observation import NO_DEPTH, OBJECT
from pmpnbp.scene.observe import observe
from pmpnbp.scene.prior import UniformPrior
from tests.inference import small_worlds as worlds

MODEL = worlds.cupboard()
ROOT, JOINTS = worlds.cupboard_truth()
CAMERA = worlds.camera_at((0.0, 0.0, 0.7), ROOT[:3] + [0, 0, 0.2])


@pytest.fixture(scope="module")
def scene() -> Problem:
    scan = worlds.scan(MODEL, MODEL.part_poses(ROOT, JOINTS), CAMERA)
    observation = observe([scan], np.array([*(ROOT[:3] - 0.6), *(ROOT[:3] + 0.7)]), up=worlds.UP)
    return problems.build(MODEL, observation, UniformPrior("upright"), worlds.settings(), particles=20)


def seen_in(scene: Problem, *depths: np.ndarray) -> Problem:
    """The problem with a view of each of some depth images."""
    view = scene.observation.views[0]
    views = tuple(
        replace(view, depth=depth, category=np.where(depth > 0, OBJECT, NO_DEPTH).astype(np.uint8)) for depth in depths
    )
    return replace(scene, observation=replace(scene.observation, views=views))


@pytest.mark.parametrize("tolerance", [None, 0.02])
def test_each_pixel_confirms_denies_or_says_nothing(scene: Problem, tolerance: float | None) -> None:
    """Columns of the picture as it should be, without depth, with something in front, 6 mm and far behind it."""
    rendered, number = render(scene.observation.views[0].camera, scene.surfaces, MODEL.part_poses(ROOT, JOINTS))
    covered = number >= 0
    kinds = np.broadcast_to(np.arange(rendered.shape[1]) % 5, rendered.shape)
    changes = np.array([0.0, -1.0, -0.1, 0.006, 0.5], dtype=np.float32)[kinds]
    depth = np.where(covered & (kinds != 1), rendered + changes, np.float32(0))
    tau = tolerance or scene.tolerance_end
    weight, near = (image.astype(np.float64) / scene.unit_distance for image in (rendered, depth))
    asked = [covered & (kinds == kind) for kind in range(5)]
    told = np.sum(near[asked[0]] ** 2) + (1 - (0.006 / tau) ** 2) * np.sum(near[asked[3]] ** 2)
    told -= np.sum(weight[asked[4]] ** 2) + scene.settings.occlusion_cost * np.sum(weight[asked[2]] ** 2)
    expected = told / (sum(np.sum(near[asked[kind]] ** 2) for kind in (0, 3)) + np.sum(weight[asked[4]] ** 2))
    assert 0.2 < expected < 0.6
    found = confirmation(seen_in(scene, depth), ROOT, JOINTS, tolerance)
    assert found.explained == pytest.approx(expected, abs=2e-3)
    assert found.hidden == np.count_nonzero(asked[2])
    assert found.confirmed == np.count_nonzero(asked[0]) + np.count_nonzero(asked[3])
    # views count by their pixels; where there is nothing to compare with, nothing is explained
    empty = np.zeros_like(depth)
    assert confirmation(seen_in(scene, depth, empty), ROOT, JOINTS, tolerance).explained == found.explained
    assert confirmation(seen_in(scene, empty), ROOT, JOINTS, tolerance).explained == 0.0


def test_a_picture_as_it_should_be_confirms_all(scene: Problem) -> None:
    rendered, _ = render(scene.observation.views[0].camera, scene.surfaces, MODEL.part_poses(ROOT, JOINTS))
    assert confirmation(seen_in(scene, rendered), ROOT, JOINTS).explained == pytest.approx(1.0, abs=1e-3)


def looked_through(width: float, chosen: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> tuple[str, ...]:
    """What is denied of a bar `width` metres across, where it is seen through at some of its pixels, chosen from where
    it is rendered and which of it is within its outline, all (h, w) bool."""
    model, root = worlds.articulated([], {"link0": worlds.block([0.4, width, width])}), worlds.at(0.0, 0.0, 0.2)
    observation = worlds.seen(model, root, np.zeros(0), worlds.camera_at((0.0, 0.7, 0.7), root[:3]))
    prior = worlds.rough_prior(np.random.default_rng(0), root)
    bar = problems.build(model, observation, prior, worlds.settings(), particles=20)
    rendered, number = render(bar.observation.views[0].camera, bar.surfaces, model.part_poses(root, np.zeros(0)))
    own = number >= 0
    assert confirmation(seen_in(bar, rendered), root, np.zeros(0)).denied == ()
    behind = np.float32(0.5) * chosen(own, ndimage.binary_erosion(own, np.ones((3, 3)))).astype(np.float32)
    return confirmation(seen_in(bar, rendered + behind), root, np.zeros(0)).denied


def test_a_part_is_not_denied_by_its_outline_alone() -> None:
    """A model that is a pixel off is seen past along its outline, of which a frame or a strip has much."""

    def along(own: np.ndarray, within: np.ndarray) -> np.ndarray:
        assert 0.2 < np.mean(~within[own]) < 0.4
        return own & ~within

    def scattered(own: np.ndarray, within: np.ndarray) -> np.ndarray:
        """As many within, so that no clump denies it."""
        inner = np.argwhere(within)
        rows = np.arange(np.count_nonzero(own & ~within)) * len(inner) // np.count_nonzero(own & ~within)
        found = np.zeros(own.shape, dtype=bool)
        found[tuple(inner[rows].T)] = True
        return found

    assert looked_through(0.04, along) == ()
    assert looked_through(0.04, scattered) == ("link0",)


def test_a_bar_that_is_all_outline_is_denied_where_it_is_seen_through() -> None:
    def everywhere(own: np.ndarray, within: np.ndarray) -> np.ndarray:
        assert np.count_nonzero(own) >= 40 and not within.any()
        return own

    assert looked_through(0.01, everywhere) == ("link0",)


@pytest.mark.parametrize(
    ("through", "without", "denied", "held"),
    [
        ([1], [], ("link1",), ("link1",)),
        ([1], [2], ("link1",), ()),
        ([1, 2], [], ("link1", "link2"), ()),
        ([2], [], ("link2",), ()),
        ([0], [], ("link0",), ()),
    ],
)
def test_what_is_seen_through_is_held_by_what_hangs_on_it(
    through: list[int], without: list[int], denied: tuple[str, ...], held: tuple[str, ...]
) -> None:
    """Three blocks in a row: `through` are seen through, nothing is measured of those `without`."""
    joints = [
        Joint(f"hinge{k}", "revolute", f"link{k}", f"link{k + 1}", worlds.at(0.0, 0.3), worlds.X, -1.0, 1.0, (k,))
        for k in range(2)
    ]
    model = worlds.articulated(joints, {f"link{k}": worlds.block([0.2, 0.2, 0.2]) for k in range(3)})
    root, straight = worlds.at(0.0, -0.3, 0.2), np.zeros(2)
    observation = worlds.seen(model, root, straight, worlds.camera_at((1.2, 0.0, 0.7), (0.0, 0.0, 0.2)))
    prior = worlds.rough_prior(np.random.default_rng(0), root)
    row = problems.build(model, observation, prior, worlds.settings(), particles=20)
    rendered, number = render(row.observation.views[0].camera, row.surfaces, model.part_poses(root, straight))
    depth = np.where(np.isin(number, through), rendered + np.float32(0.5), rendered)
    found = confirmation(seen_in(row, np.where(np.isin(number, without), np.float32(0), depth)), root, straight)
    assert (found.denied, found.held) == (denied, held)
