"""Coordinates of draws are those of the draws themselves, joint by joint and link by link."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pmpnbp.geometry import poses
from pmpnbp.inference import problem as problems
from pmpnbp.inference import run
from pmpnbp.readout.coordinates import Coordinate, coordinates
from pmpnbp.readout.mixture import of_estimate
from pmpnbp.readout.placement import Placement, place
from pmpnbp.scene.prior import UniformPrior
from tests.inference import small_worlds as worlds

MODEL = worlds.cupboard()


@pytest.fixture(scope="module")
def placed() -> Placement:
    root, joints = worlds.cupboard_truth()
    built = problems.build(
        MODEL, worlds.seen(MODEL, root, joints), UniformPrior("upright"), worlds.settings(), particles=20
    )
    _, made = run.begin(built)
    report = replace(
        made, iteration=9, stage="belief propagation", map_poses=MODEL.part_poses(root, joints), map_joints=joints
    )
    return place(built, report, of_estimate(built, report))


def found(placed: Placement, *links: str) -> dict[tuple[str | None, str], Coordinate]:
    assert placed.posterior is not None
    return {(one.link, one.name): one for one in coordinates(MODEL, placed.posterior, placed, links)}


def test_joints_are_told_first_and_links_that_are_asked_for(placed: Placement) -> None:
    joints = [(None, f"joint {joint.name}") for joint in MODEL.joints]
    assert list(found(placed)) == joints
    pose = ("x", "y", "z", "roll", "pitch", "yaw")
    assert list(found(placed, "link2")) == joints + [("link2", name) for name in pose]


def test_each_draw_is_of_one_configuration(placed: Placement) -> None:
    told, posterior = found(placed, "link1", "link2"), placed.posterior
    assert posterior is not None
    for number, draw in enumerate(zip(posterior.drawn_roots, posterior.drawn_joints, strict=True)):
        links = MODEL.link_poses(MODEL.part_poses(*draw), draw[1])
        for entry, joint in enumerate(MODEL.joints):
            assert told[None, f"joint {joint.name}"].values[number] == draw[1][entry]
        for link in ("link1", "link2"):
            pose = links[MODEL.links.index(link)]
            position = [told[link, name].values[number] for name in "xyz"]
            np.testing.assert_allclose(position, pose[:3], atol=1e-12)
            angles = [told[link, name].values[number] for name in ("roll", "pitch", "yaw")]
            turn = Rotation.from_euler("xyz", angles)
            wanted = Rotation.from_quat(pose[[4, 5, 6, 3]])
            assert (turn.inv() * wanted).magnitude() < 1e-7


def test_the_estimate_is_in_the_same_numbers(placed: Placement) -> None:
    told = found(placed, "link1")
    row = MODEL.links.index("link1")
    for entry, joint in enumerate(MODEL.joints):
        assert told[None, f"joint {joint.name}"].estimate == placed.joint_positions[entry]
    for axis, name in enumerate("xyz"):
        assert told["link1", name].estimate == placed.link_poses[row, axis]
    units = {name: one.unit for (_, name), one in told.items()}
    assert (units["x"], units["yaw"]) == ("m", "rad")
    kinds = {"prismatic": "m", "revolute": "rad"}
    assert all(units[f"joint {joint.name}"] == kinds[joint.kind] for joint in MODEL.joints)


def test_angles_are_counted_from_the_estimate(placed: Placement) -> None:
    """Turned so that the link's yaw is half a turn, where angles end, its draws lie at either side of the end."""
    posterior, row = placed.posterior, MODEL.links.index("link0")
    assert posterior is not None
    half_turn = np.array([0.0, 0.0, 0.0, *Rotation.from_euler("z", np.pi).as_quat()[[3, 0, 1, 2]]])
    turn = poses.multiply(half_turn, poses.inverse(placed.link_poses[row]))
    swung = posterior.drawn_roots.copy()
    swung[::2] = poses.multiply(np.array([0.0, 0, 0, np.cos(0.05), 0, 0, np.sin(0.05)]), swung[::2])
    turned = replace(
        placed,
        standing=replace(
            placed.standing,
            link_poses=poses.multiply(turn, placed.link_poses),
            posterior=replace(posterior, drawn_roots=poses.multiply(turn, swung)),
        ),
    )
    yaw = found(turned, "link0")["link0", "yaw"]
    assert abs(abs(yaw.estimate) - np.pi) < 1e-6
    assert np.abs(yaw.values - yaw.estimate).max() < 0.5
    assert np.ptp(yaw.values) > 0.08
