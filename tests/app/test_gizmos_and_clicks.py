"""Are handles where region and prior are, do they follow a hand, and does a click pick what it is aimed at?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.viewer.gizmos import (
    HIGH,
    LOW,
    PRIOR,
    default_prior,
    default_region,
    dragged_prior,
    dragged_region,
    proposal_at,
)
from app.viewer.picking import AIM, picked
from app.viewer.scene_frame import Handle, Label, Lines
from pmpnbp.geometry import poses
from tests.app.scenes import drawn, estimated, only, scene, shown


def test_region_and_prior_can_be_dragged() -> None:
    region = (-1.0, -1.0, 0.0, 1.0, 1.0, 2.0)
    found = drawn(only("region", region=region))
    np.testing.assert_array_equal(shown(Handle, found, LOW).pose[:3], region[:3])
    np.testing.assert_array_equal(shown(Handle, found, HIGH).pose[:3], region[3:])
    assert len(shown(Lines, found, "/region/box").segments) == 12
    assert dragged_region(region, LOW, np.array([-2, 0, 1])) == (-2, 0, 1, 1, 1, 2)
    assert dragged_region(region, HIGH, np.array([3, 0, 1])) == (-1, -1, 0, 3, 0, 1)
    for corner in (LOW, HIGH):  # past the other corner
        box = dragged_region(region, corner, np.array([9.0, -9.0, 9.0] if corner == LOW else [-9.0, 9.0, -9.0]))
        assert all(low < high for low, high in zip(box[:3], box[3:], strict=True))

    made = scene().snapshots[-1]
    assert default_region(made.problem.observation) == pytest.approx(made.problem.observation.roi, abs=1e-4)
    prior = default_prior(scene().stage.model, made.result["links"], None)
    handle = shown(Handle, drawn(only("prior", prior=prior)), PRIOR)
    np.testing.assert_allclose(handle.pose, estimated(made)[0], atol=1e-6)
    moved = poses.from_xyz_rpy([1.0, 2.0, 3.0], [0.0, 0.0, 0.5])
    handle = shown(Handle, drawn(only("prior", prior=dragged_prior(prior, moved))), PRIOR)
    np.testing.assert_allclose(handle.pose, moved, atol=1e-5)


def test_a_prior_that_nobody_has_set_is_laid_into_the_region() -> None:
    made, region = scene().snapshots[-1], (1.0, 2.0, 3.0, 2.0, 3.0, 5.0)
    prior = default_prior(scene().stage.model, made.result["links"], region)
    found = drawn(only("prior", prior=prior))
    corners = np.concatenate(
        [
            poses.transform_points(line.pose, line.segments.reshape(-1, 3))
            for line in found.nodes
            if isinstance(line, Lines) and line.name.startswith("/prior/edges/")
        ]
    )
    # the whole object is drawn, its joints at rest
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    np.testing.assert_allclose(middle, [1.5, 2.5, 4.0], atol=0.02)
    where = made.result["links"][prior["link"]]["pose"]["orientation"]
    assert prior["pose"]["orientation"] == pytest.approx(where, abs=1e-5)


def test_regions_are_offered_and_a_click_takes_the_one_in_front() -> None:
    near, far = (0.0, -0.5, 0.0, 1.0, 0.5, 1.0), (3.0, -0.5, 0.0, 4.0, 0.5, 1.0)
    found = drawn(only("region", proposals=(near, far), region=near))
    names = {node.name for node in found.nodes}
    assert {"/proposals/2", "/region/box"} <= names and "/proposals/1" not in names  # the chosen one is drawn once
    assert [shown(Label, found, f"/proposals/{number}/number").text for number in (1, 2)] == ["1", "2"]
    np.testing.assert_allclose(shown(Label, found, "/proposals/2/number").pose[:3], [3.5, 0.0, 1.0])
    eye, ahead = np.array([-1.0, 0.0, 0.5]), np.array([1.0, 0.0, 0.0])
    assert proposal_at([far, near], eye, ahead) == near
    assert proposal_at([far, near], eye, -ahead) is None  # behind it
    assert proposal_at([far, near], np.array([2.0, 0.0, 0.5]), ahead) == far
    assert proposal_at([far, near], np.array([0.5, 0.0, 9.0]), np.array([0.0, 0.0, -1.0])) == near
    assert proposal_at([], eye, ahead) is None


def test_a_click_picks_the_particle_it_is_aimed_at() -> None:
    found = drawn(only("particles", "estimate"))
    targets, eye = found.targets, np.array(scene().stage.eye.position)
    # not all are drawn, and the processor's last bits decide which
    in_sight = np.flatnonzero(np.isfinite(targets.particles[2]).all(axis=1))
    aim = targets.particles[2, in_sight[5]] - eye
    part, particle = picked(targets, eye, 3 * aim) or (None, None)
    assert part is not None and particle is not None
    chosen = targets.particles[part, particle] - eye
    cosine = chosen @ aim / np.linalg.norm(chosen) / np.linalg.norm(aim)
    assert np.arccos(min(cosine, 1.0)) < 1e-6
    assert picked(targets, eye, -aim) is None  # behind the eye
    hidden = replace(targets, particles_shown=False, estimate_shown=False)
    assert picked(hidden, eye, aim) is None


def test_a_click_beside_all_particles_picks_the_part_in_front() -> None:
    whole, found = scene(), drawn(only("particles", "estimate"))
    # the cabinet's top, from above: the drawers lie below it
    eye = estimated(whole.snapshots[-1])[0][:3] + [0.05, 0.1, 5.0]
    assert picked(found.targets, eye, np.array([0.0, 0.0, -1.0])) == (0, None)
    assert picked(drawn(only("particles")).targets, eye, np.array([0.0, 0.0, -1.0])) is None
    aside = np.array([np.sin(0.5), 0.0, -np.cos(0.5)])
    assert picked(found.targets, eye, aside) is None
    assert 0.003 < AIM < 0.02
