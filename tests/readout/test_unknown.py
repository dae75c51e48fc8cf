"""What the scan does not tell at all is said: a hidden drawer, and how a round plate is turned."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy import stats

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import problem as problems
from pmpnbp.inference.problem import Problem
from pmpnbp.readout.fit import Fit
from pmpnbp.readout.free_turn import free_turn, turned_anyhow
from pmpnbp.readout.object_posterior import mode_draws
from pmpnbp.readout.posterior import ObjectMode, Posterior, spread
from pmpnbp.readout.surface_distance import part_surfaces, turn_agreement
from pmpnbp.readout.unknown import unknown
from pmpnbp.scene.articulated_object import ArticulatedObject, Joint, Mesh
from pmpnbp.scene.parts import LinkSurface
from pmpnbp.scene.prior import GaussianPrior, UniformPrior
from tests.inference import small_worlds as worlds
from tests.inference.small_worlds import X, Z, articulated, at, block

UPRIGHT = UniformPrior("upright")


def cylinder(radius: float, length: float) -> LinkSurface:
    made = trimesh.creation.cylinder(radius, length, sections=48)
    return LinkSurface(
        exact=(Mesh(np.asarray(made.vertices, dtype=np.float64), np.asarray(made.faces, dtype=np.int32)),)
    )


def told_of(
    model: ArticulatedObject,
    root: Array,
    joints: Array,
    eye: float = 0.7,
    prior: UniformPrior | GaussianPrior = UPRIGHT,
) -> tuple[str, ...]:
    """What is unknown of a model that is seen at a configuration from a height `eye`, drawn from there."""
    observation = worlds.seen(model, root, joints, worlds.camera_at((0.0, 0.0, eye), root[:3]), margin=0.3)
    made: Problem = problems.build(model, observation, prior, worlds.settings(), particles=20)
    draws = mode_draws(np.random.default_rng(3), made, root, joints)
    posterior = Posterior(
        iteration=0,
        root=root,
        joints=joints,
        drawn_roots=draws.roots,
        drawn_joints=draws.joints,
        log_weights=draws.log_weights,
        mode=np.zeros(len(draws.roots), dtype=np.int64),
        modes=(ObjectMode(weight=1.0, root=root, joints=joints),),
        effective_sample_size=draws.effective_sample_size,
        fit=Fit(verdict="good", reason="as a test says", explained=1.0),
    )
    return unknown(made, posterior, spread(made, posterior, root, joints))


def test_a_drawer_that_cannot_be_seen_is_named_with_where_it_may_be() -> None:
    slide = Joint("slide", "prismatic", "link0", "link1", at(0.148, 0.0, 0.2), X, 0.0, 0.25, (0,))
    model = articulated(
        [slide], {"link0": block([0.3, 0.4, 0.4], at(z=0.2)), "link1": block([0.2, 0.3, 0.2], at(-0.1))}
    )
    front, back = at(1.4, 0.0, 0.0, yaw=np.pi - 0.35), at(1.4, 0.0, 0.0, yaw=0.05)
    assert told_of(model, front, np.array([0.05])) == ()
    (sentence,) = told_of(model, back, np.array([0.05]), eye=0.3)
    assert re.fullmatch(r"joint 'slide' may be anywhere from \d cm to \d\d cm", sentence)
    # what a prior leaves is not all that the joint may go over
    loose, known = np.full(3, 0.1), {"slide": (0.05, 1e-4)}
    assert told_of(model, back, np.array([0.05]), 0.3, GaussianPrior("link0", back, loose, loose, known)) == ()


def test_a_turn_that_moves_nothing_is_told_in_degrees() -> None:
    """As of a root link without geometry, about which the object turns: no part's pose depends on it."""
    turn = Joint("turn", "revolute", "link0", "link1", at(), Z, -0.84, 0.84, (0,))
    model = articulated([turn], {"link1": block([0.4, 0.25, 0.2])})
    (sentence,) = told_of(model, at(1.2, 0.0, 0.1, yaw=0.3), np.array([0.1]))
    assert re.fullmatch(r"joint 'turn' may be anywhere from -[34]\d° to [34]\d°", sentence)


def test_places_of_a_joint_that_hardly_moves_are_told_apart() -> None:
    slide = Joint("slide", "prismatic", "link0", "link1", at(0.148, 0.0, 0.2), X, 0.0, 0.001, (0,))
    model = articulated(
        [slide], {"link0": block([0.3, 0.4, 0.4], at(z=0.2)), "link1": block([0.2, 0.3, 0.2], at(-0.1))}
    )
    (sentence,) = told_of(model, at(1.4, 0.0, 0.0, yaw=0.05), np.array([0.0005]), eye=0.3)
    low, high = sentence.removeprefix("joint 'slide' may be anywhere from ").removesuffix(" cm").split(" cm to ")
    assert len(low) == len(high) == len("0.01")
    assert 0 <= float(low) < 0.02 and 0.08 < float(high) <= 0.1


def test_a_round_foot_may_be_turned_and_its_first_joint_with_it() -> None:
    """The bar on it is seen well; which of the angles is the foot's and which the joint's cannot be."""
    turn = Joint("turn", "revolute", "link0", "link1", at(0, 0, 0.1), Z, -3.0, 3.0, (0,))
    model = articulated([turn], {"link0": cylinder(0.15, 0.2), "link1": block([0.4, 0.08, 0.3], at(0.1, 0, 0.15))})
    found = told_of(model, at(1.2, 0.0, 0.1, yaw=0.3), np.array([0.4]))
    assert len(found) == 2 and found[0].startswith("joint 'turn' may be anywhere from -")
    assert found[1] == "'link0' is round, and may be turned by any angle about its axis"


@pytest.mark.parametrize(
    ("lower", "upper", "mimics", "whole_turns"),
    [
        (-3.1, 3.1, False, False),
        (-2 * np.pi, 2 * np.pi, False, True),
        (-90.0, 90.0, False, True),
        (-7.0, 7.0, True, False),
    ],
)
def test_a_joint_that_may_turn_round_may_have_been(lower: float, upper: float, mimics: bool, whole_turns: bool) -> None:
    """Of limits in degrees, too. A slide that follows the turn tells how often it was turned."""
    turn = Joint("turn", "revolute", "link0", "link1", at(0, 0, 0.1), Z, lower, upper, (0,))
    links = {"link0": block([0.4, 0.25, 0.2]), "link1": block([0.4, 0.08, 0.3], at(0.1, 0, 0.15))}
    joints = [turn]
    if mimics:
        joints.append(Joint("slide", "prismatic", "link0", "link2", at(0.1, 0, 0), X, -1.0, 1.0, (0,), "turn", 0.03))
        links["link2"] = block([0.3, 0.2, 0.05])
    found = told_of(articulated(joints, links), at(1.2, 0.0, 0.1, yaw=0.3), np.array([0.5]))
    assert found == (("joint 'turn' may be whole turns from 29°, which look the same",) if whole_turns else ())


def test_a_foot_that_looks_the_same_in_two_turns_and_where_the_joint_on_it_is_then() -> None:
    """The bar on it is seen well, a hand's breadth off its middle; half a turn of the foot takes the joint with it."""
    turn = Joint("turn", "revolute", "link0", "link1", at(0, 0, 0.1), Z, -3.1, 3.1, (0,))
    foot = block([0.4, 0.25, 0.2])
    links = {"link0": foot, "link1": block([0.4, 0.08, 0.3], at(0.1, 0, 0.15))}
    model = articulated([turn], links)
    places = [
        (at(1.2, 0.0, 0.1, yaw=0.3), np.array([1.5])),
        (at(1.2, 0.0, 0.1, yaw=0.3 - np.pi), np.array([1.5 - np.pi])),
    ]
    observation = worlds.seen(model, *places[0], worlds.camera_at((0.0, 0.0, 0.7), places[0][0][:3]), margin=0.3)
    made: Problem = problems.build(model, observation, UniformPrior("upright"), worlds.settings(), particles=20)
    two = of_modes(made, places, [0.6, 0.4])
    told = spread(made, two, *places[0])
    assert unknown(made, two, told) == (
        "joint 'turn' may be at -94° or 86°",
        "'link0' may be turned in 2 ways that look the same",
    )
    doubts = told.doubts(two, 0.0025)
    assert doubts["alike"].tolist() == [True, False] and doubts["elsewhere"].tolist() == [True, False]
    # nor do whole turns tell from which
    free = articulated([replace(turn, lower=-20.0, upper=20.0)], links)
    wound = problems.build(free, observation, UPRIGHT, worlds.settings(), particles=20)
    assert unknown(wound, two, spread(wound, two, *places[0]))[0] == (
        "joint 'turn' may be at -94° or 86°, and whole turns from there"
    )
    # two modes of one turn are one way
    tilted = (places[1][0], places[1][1] + 0.02)
    three = of_modes(made, [*places, tilted], [0.5, 0.3, 0.2])
    assert unknown(made, three, spread(made, three, *places[0])) == unknown(made, two, told)
    # what weighs next to nothing is no doubt, and no other way
    few = of_modes(made, places, [0.995, 0.005])
    told = spread(made, few, *places[0])
    assert unknown(made, few, told) == () and not told.doubts(few, 0.0025)["alike"].any()
    # a foot with something on one side of it is elsewhere when it is turned
    lopsided = LinkSurface(exact=(*foot.exact, *block([0.05, 0.05, 0.05], at(0.15, 0, 0.12)).exact))
    model = articulated([turn], {"link0": lopsided, "link1": block([0.4, 0.08, 0.3], at(0.1, 0, 0.15))})
    made = problems.build(model, observation, UniformPrior("upright"), worlds.settings(), particles=20)
    two = of_modes(made, places, [0.6, 0.4])
    told = spread(made, two, *places[0])
    assert unknown(made, two, told) == ()
    doubts = told.doubts(two, 0.0025)
    assert not doubts["alike"].any() and doubts["elsewhere"].tolist() == [True, False]


def of_modes(made: Problem, places: list[tuple[Array, Array]], weights: list[float]) -> Posterior:
    """A posterior of modes at places (root, joints), each drawn a millimetre and a milliradian about."""
    rng, count = np.random.default_rng(5), 200
    roots = [poses.perturb(root, *(1e-3 * rng.standard_normal((2, count, 3)))) for root, _ in places]
    joints = [joints + 1e-3 * rng.standard_normal((count, len(joints))) for _, joints in places]
    return Posterior(
        iteration=0,
        root=places[0][0],
        joints=places[0][1],
        drawn_roots=np.concatenate(roots),
        drawn_joints=np.concatenate(joints),
        log_weights=np.log(np.repeat(weights, count) / count),
        mode=np.repeat(np.arange(len(places)), count),
        modes=tuple(
            ObjectMode(weight=weight, root=root, joints=joints)
            for weight, (root, joints) in zip(weights, places, strict=True)
        ),
        effective_sample_size=float(count),
        fit=Fit(verdict="good", reason="as a test says", explained=1.0),
    )


def test_turns_about_the_axis_agree_where_they_are_the_same(rng: np.random.Generator) -> None:
    surfaces = part_surfaces(articulated([], {"link0": cylinder(0.1, 0.3)}))
    here = at(0.2, 0.1, 0.5, roll=0.7)[None]
    same = np.tile(poses.multiply(here, at(yaw=2.0)), (500, 1, 1))
    any_turn = poses.multiply(here, np.array([at(yaw=angle) for angle in rng.uniform(-np.pi, np.pi, 500)]))[:, None]
    tilted = poses.multiply(here, np.array([at(pitch=angle) for angle in rng.uniform(-0.1, 0.1, 500)]))[:, None]
    assert turn_agreement(surfaces, here, same).item() == pytest.approx(1.0)
    # of 500 turns at random the mean is longer than 0.2 once in five hundred million times (Rayleigh)
    assert turn_agreement(surfaces, here, any_turn).item() < 0.2
    assert turn_agreement(surfaces, here, tilted).item() > 0.99
    assert np.isnan(turn_agreement(part_surfaces(articulated([], {"link0": block([0.3, 0.3, 0.1])})), here, same)).all()


def test_a_free_turn_changes_nothing_that_can_be_seen(rng: np.random.Generator) -> None:
    """The root's surface stays on itself and everything behind the joint where it is; limits are kept, and every angle
    within them is as likely: of 4,000 the largest gap to even shares is over 0.04 once in three million times
    (Kolmogorov)."""
    turn = Joint("turn", "revolute", "link0", "link1", at(0, 0, 0.1), -Z, -1.0, 2.0, (0,))
    hinge = Joint("hinge", "revolute", "link1", "link2", at(0.2), X, -1.0, 1.0, (1,))
    shapes = {"link0": cylinder(0.15, 0.2), "link1": block([0.4, 0.08, 0.3]), "link2": block([0.1, 0.1, 0.1])}
    model = articulated([turn, hinge], shapes)
    free = free_turn(model)
    assert free is not None and free.coordinates == (0,) and free.back == (1.0,)
    root, joints = at(1.2, 0.4, 0.1, roll=0.2, yaw=0.3), np.array([0.5, 0.3])
    roots, q = turned_anyhow(rng, model, free, np.tile(root, (4000, 1)), np.tile(joints, (4000, 1)))
    before, after = model.part_poses(root, joints), model.part_poses(roots, q)
    for node in (1, 2):
        np.testing.assert_allclose(after[:, node, :3], np.tile(before[node, :3], (4000, 1)), atol=1e-9)
        assert poses.rotation_angle(after[:, node, 3:], before[node, 3:]).max() < 1e-6
    axes = poses.rotate(after[:, 0, 3:], np.tile(Z, (4000, 1)))
    np.testing.assert_allclose(axes, np.tile(poses.rotate(before[0, 3:], Z), (4000, 1)), atol=1e-9)
    np.testing.assert_allclose(roots[:, :3], np.tile(root[:3], (4000, 1)), atol=1e-9)
    assert stats.kstest(q[:, 0], stats.uniform(-1.0, 3.0).cdf).statistic < 0.04


@pytest.mark.parametrize("where", ["beside its axis", "across it", "sliding"])
def test_a_joint_elsewhere_tells_how_the_root_is_turned(where: str) -> None:
    pose = at(0.05, 0, 0.1) if where == "beside its axis" else at(0, 0, 0.1)
    kind = "prismatic" if where == "sliding" else "revolute"
    joint = Joint("turn", kind, "link0", "link1", pose, X if where == "across it" else Z, -1.0, 1.0, (0,))
    model = articulated([joint], {"link0": cylinder(0.15, 0.2), "link1": block([0.4, 0.08, 0.3])})
    assert free_turn(model) is None
