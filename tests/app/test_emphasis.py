"""Does a scene frame put forward what weighs much and what was selected, and name the frames where that is asked?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from app.viewer.frames import frame
from app.viewer.scene_frame import Axes, Ellipsoids, Label, Surface
from pmpnbp.geometry import poses
from tests.app.scenes import drawn, of_a_part, only, scene, shown

NAMES = ("frame", "drawer1", "drawer2", "drawer3")


def test_the_heavier_a_particle_the_larger_and_none_of_weight_zero() -> None:
    whole = scene()
    newest = whole.snapshots[-1]
    belief = newest.report.belief
    log_weights = belief.log_weights.copy()
    # of the first part one of each size, and two of no weight
    log_weights[:2] = -np.inf
    log_weights[0, :4] = np.log([0.7, 0.02, 0.0004, 1e-7])
    told = replace(newest, report=replace(newest.report, belief=replace(belief, log_weights=log_weights)))
    found = frame(told, only("particles"), whole.stage)
    clouds = of_a_part(found, 0)
    for cloud, particle in zip(clouds, range(3), strict=True):
        np.testing.assert_allclose(cloud.points, belief.poses[0, particle : particle + 1, :3], atol=1e-6)
    sizes = [cloud.size for cloud in clouds]
    assert sizes == sorted(sizes, reverse=True) and len(set(sizes)) == 3
    assert found.particles["frame"] == 3
    # what is not there cannot be clicked
    assert np.isfinite(found.targets.particles[0, :3]).all() and np.isnan(found.targets.particles[0, 3:]).all()
    # where nothing has a weight, all are there
    assert found.particles["drawer1"] == 40


def test_the_selected_part_is_bright_and_the_others_are_faded() -> None:
    layers = ("estimate", "particles", "ellipsoids")
    plain, chosen = drawn(only(*layers)), drawn(only(*layers, part="drawer2"))
    for number, name in enumerate(NAMES):
        own = name == "drawer2"
        one, other = (shown(Surface, found, f"/estimate/{number}") for found in (plain, chosen))
        assert (one.colour == other.colour, one.opacity == other.opacity) == (own, own)
        assert other.opacity <= one.opacity
        one, other = (of_a_part(found, number)[0] for found in (plain, chosen))
        assert np.array_equal(one.colours, other.colours) == own
    one, other = (shown(Ellipsoids, found, "/ellipsoids").opacities for found in (plain, chosen))
    np.testing.assert_array_equal(one == other, [name == "drawer2" for name in NAMES])
    # of an edge whose messages are shown both parts are bright
    ends = drawn(only("estimate", "messages", edge=["frame", "drawer2"]))
    same = [
        shown(Surface, ends, f"/estimate/{n}").colour == shown(Surface, plain, f"/estimate/{n}").colour
        for n in range(4)
    ]
    assert same == [True, False, True, False]


def test_frames_have_axes_and_names() -> None:
    found, whole = drawn(only("frames")), scene()
    axes = shown(Axes, found, "/frames/axes")
    camera = whole.stage.scans[0].camera.pose_world_camera
    np.testing.assert_array_equal(axes.poses[:2], [poses.IDENTITY, camera])
    np.testing.assert_array_equal(axes.poses[2:], whole.snapshots[-1].placed.part_poses)
    labels = [node for node in found.nodes if isinstance(node, Label)]
    assert [label.text for label in labels] == ["world", "camera", *NAMES]
    np.testing.assert_array_equal([label.pose for label in labels], axes.poses)
