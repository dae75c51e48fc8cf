"""What a place leaves, on two cupboards side by side: the one is explained, the other is left."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pmpnbp.geometry.poses import Array
from pmpnbp.inference import problem as problems
from pmpnbp.inference.confirmation import confirmation
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.unexplained import unexplained
from pmpnbp.scene.observation import OBJECT
from pmpnbp.scene.observe import observe
from pmpnbp.scene.prior import UniformPrior
from tests.inference import small_worlds as worlds

MODEL = worlds.cupboard()
ROOT, JOINTS = worlds.cupboard_truth()
OTHER = np.concatenate([ROOT[:3] + [0.0, 0.8, 0.0], ROOT[3:]])
CAMERA = worlds.camera_at((0.0, 0.0, 0.7), (ROOT[:3] + OTHER[:3]) / 2 + [0, 0, 0.2])


def built(*places: Array) -> Problem:
    """A scan of a cupboard at each of the places."""
    scans = [worlds.scan(MODEL, MODEL.part_poses(place, JOINTS), CAMERA) for place in places]
    scan = replace(scans[0], depth=np.min([one.depth for one in scans], axis=0))
    box = np.array([*(ROOT[:3] - [0.6, 0.6, 0.1]), *(OTHER[:3] + [0.6, 0.6, 0.7])])
    observation = observe([scan], box, up=worlds.UP)
    return problems.build(MODEL, observation, UniformPrior("upright"), worlds.settings(), particles=20)


def test_of_one_thing_little_is_left_and_of_two_the_other() -> None:
    alone, both = built(ROOT), built(ROOT, OTHER)
    assert unexplained(alone, ROOT, JOINTS).left < 0.3
    rest = unexplained(both, ROOT, JOINTS)
    assert 0.6 < rest.left < 1.7 and not rest.outside
    # what was explained is out of the race, the other is not
    before, after = (confirmation(problem, ROOT, JOINTS) for problem in (both, rest.problem))
    assert before.explained > 0.9 and after.score < 0.6 * before.score
    assert confirmation(rest.problem, OTHER, JOINTS).explained > 0.9
    assert sum(int(np.count_nonzero(view.category == OBJECT)) for view in rest.problem.observation.views) < sum(
        int(np.count_nonzero(view.category == OBJECT)) for view in both.observation.views
    )


def test_where_nothing_is_explained_everything_is_left() -> None:
    nowhere = np.concatenate([ROOT[:3] + [0, 0, 5.0], ROOT[3:]])
    assert unexplained(built(ROOT), nowhere, JOINTS).left > 1
