"""prior.json: what is read from it, and what is said of one that does not fit the model."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pmpnbp.errors import PriorError
from pmpnbp.geometry import poses
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.prior import GaussianPrior, UniformPrior, load_prior
from pmpnbp.scene.urdf import load_model

URDF = """<robot name="r">
{links}
<joint name="slide" type="prismatic"><parent link="base"/><child link="drawer"/><axis xyz="1 0 0"/>
  <limit lower="0" upper="0.3" effort="1" velocity="1"/></joint>
<joint name="glue" type="fixed"><parent link="drawer"/><child link="handle"/></joint>
<joint name="echo" type="prismatic"><parent link="base"/><child link="twin"/><axis xyz="1 0 0"/>
  <limit lower="0" upper="0.3" effort="1" velocity="1"/><mimic joint="slide"/></joint>
<joint name="hinge" type="revolute"><parent link="base"/><child link="leaf"/>
  <limit lower="-1" upper="1.5" effort="1" velocity="1"/></joint>
<joint name="wheel" type="continuous"><parent link="base"/><child link="rim"/></joint>
</robot>"""
LINK = '<link name="{}"><visual><geometry><box size="0.1 0.2 0.3"/></geometry></visual></link>'
POSE = {"position": {"x": 1, "y": 2.0, "z": 3.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8}}
GAUSSIAN = {"kind": "gaussian", "link": "base", "pose": POSE, "std_xyz": [0.1, 0.2, 0.3], "std_rpy": [0.4, 0.5, 0.6]}


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> ArticulatedObject:
    path = tmp_path_factory.mktemp("model") / "r.urdf"
    path.write_text(
        URDF.format(links="\n".join(LINK.format(name) for name in ("base", "drawer", "handle", "twin", "leaf", "rim")))
    )
    return load_model(path)


def test_uniform(model: ArticulatedObject, tmp_path: Path) -> None:
    assert load_prior({"kind": "uniform"}, model) == UniformPrior("upright")
    (tmp_path / "prior.json").write_text('{"kind": "uniform", "orientation": "any"}')
    assert load_prior(tmp_path / "prior.json", model) == UniformPrior("any")


def test_gaussian(model: ArticulatedObject, tmp_path: Path) -> None:
    (tmp_path / "prior.json").write_text(json.dumps({**GAUSSIAN, "joints": {"slide": {"position": 0, "std": 0.1}}}))
    prior = load_prior(tmp_path / "prior.json", model)
    assert isinstance(prior, GaussianPrior)
    # the file's orientation has named members; inside, w comes first
    np.testing.assert_allclose(prior.pose_world_link, [1, 2, 3, 0.8, 0, 0, 0.6])
    np.testing.assert_array_equal(prior.std_xyz, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(prior.std_rpy, [0.4, 0.5, 0.6])
    assert (prior.link, dict(prior.joints)) == ("base", {"slide": (0.0, 0.1)})
    assert dict(load_prior({**GAUSSIAN, "link": "handle"}, model).joints) == {}  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("joint", "position", "std", "read"),
    [
        ("slide", 0.31, 1e-4, 0.31),  # an encoder with an offset
        ("slide", -0.2, 0.1, -0.2),
        ("hinge", 1.6, 1e-3, 1.6),
        ("wheel", 7.0, 0.01, 7.0 - 2 * np.pi),  # after a turn
        ("wheel", -3.0, 0.01, -3.0),
    ],
)
def test_a_joint_measured_a_little_beyond_its_limit_or_a_turn_on(
    model: ArticulatedObject, joint: str, position: float, std: float, read: float
) -> None:
    prior = load_prior({**GAUSSIAN, "joints": {joint: {"position": position, "std": std}}}, model)
    assert isinstance(prior, GaussianPrior)
    assert prior.joints[joint] == pytest.approx((read, std), abs=1e-12)


def test_a_rounded_orientation_is_brought_to_unit_length(model: ArticulatedObject) -> None:
    rounded = {**POSE, "orientation": {"x": 0.001, "y": 0.0, "z": 0.6, "w": 0.801}}
    prior = load_prior({**GAUSSIAN, "pose": rounded}, model)
    assert isinstance(prior, GaussianPrior)
    assert np.linalg.norm(prior.pose_world_link[3:]) == pytest.approx(1.0, abs=1e-12)
    assert poses.rotation_angle(prior.pose_world_link[3:], np.array([0.8, 0, 0, 0.6])) < 0.003


@pytest.mark.parametrize(
    ("members", "said"),
    [
        ({}, "'kind' of the prior is None; expected 'uniform' or 'gaussian'"),
        (
            {"kind": "uniform", "orient": "any"},
            "the prior of kind 'uniform' has the member 'orient'; it can have kind, orientation",
        ),
        (
            {**GAUSSIAN, "joint": {}},
            "of kind 'gaussian' has the member 'joint'; it can have kind, link, pose, std_xyz, std_rpy, joints",
        ),
        (
            {**GAUSSIAN, "pose": {**POSE, "frame": "map"}},
            "'pose' of the prior has the member 'frame'; it can have position, orientation",
        ),
        (
            {**GAUSSIAN, "pose": {**POSE, "position": {"x": 1, "y": 2, "z": 3, "Z": 4}}},
            "'position' in the prior has the member 'Z'; it can have x, y, z",
        ),
        (
            {**GAUSSIAN, "joints": {"slide": {"position": 0, "std": 1, "mean": 0}}},
            "joint 'slide' of the prior has the member 'mean'; it can have position, std",
        ),
        (
            {**GAUSSIAN, "joints": {"slide": {"position": 24, "std": 0.001}}},
            "the position of joint 'slide' of the prior is 24 m, with a 'std' of 0.001; expected one within its "
            "limits, 0 to 0.3 m",
        ),
        (
            {**GAUSSIAN, "joints": {"slide": {"position": -0.1, "std": 0.03}}},
            "the position of joint 'slide' of the prior is -0.1 m, with a 'std' of 0.03; expected one",
        ),
        (
            {**GAUSSIAN, "joints": {"hinge": {"position": 90, "std": 1}}},
            "the position of joint 'hinge' of the prior is 90 rad, with a 'std' of 1; expected one within its limits, "
            "-1 to 1.5 rad",
        ),
        (
            {**GAUSSIAN, "pose": {**POSE, "position": {"x": 20000, "y": 2, "z": 3}}},
            "'position' in the prior is {'x': 20000, 'y': 2, 'z': 3}; expected metres, at most 10000 from the world's",
        ),
        (
            {**GAUSSIAN, "std_xyz": [1e5, 1, 1]},
            "'std_xyz' of the prior is [100000.0, 1, 1]; expected three standard deviations above 0, at most 10000",
        ),
        ({**GAUSSIAN, "joints": {"slide": {"position": 0, "std": 1e6}}}, "and a 'std' above 0, at most 10000"),
        ({"kind": "uniform", "orientation": "sideways"}, "is 'sideways'; expected 'upright' or 'any'"),
        ({**GAUSSIAN, "link": "lid"}, "link 'lid' of the prior is not in the model; it has base, drawer, handle, twin"),
        (
            {name: value for name, value in GAUSSIAN.items() if name != "link"},
            "the prior has no link; expected one of base",
        ),
        ({**GAUSSIAN, "link": None}, "link None of the prior is not in the model; it has base"),
        ({**GAUSSIAN, "pose": None}, "has no 'pose' with a position x y z and an orientation x y z w"),
        (
            {**GAUSSIAN, "pose": {**POSE, "position": [1, 2, 3]}},
            "'position' in the prior is [1, 2, 3]; expected finite",
        ),
        ({**GAUSSIAN, "pose": {**POSE, "position": {"x": 1, "y": 2}}}, "expected finite numbers x, y, z"),
        (
            {**GAUSSIAN, "pose": {**POSE, "orientation": {"x": 0, "y": 0, "z": 0, "w": 0}}},
            "the orientation in the prior has the length 0; expected 1",
        ),
        ({**GAUSSIAN, "std_xyz": [0.1, 0.1]}, "'std_xyz' of the prior is [0.1, 0.1]; expected three standard"),
        ({**GAUSSIAN, "std_rpy": [0.1, 0.1, 0]}, "expected three standard deviations above 0"),
        ({**GAUSSIAN, "std_rpy": [0.1, 0.1, float("inf")]}, "expected three standard deviations above 0"),
        ({**GAUSSIAN, "joints": ["slide"]}, "expected an object with the joints' names"),
        (
            {**GAUSSIAN, "joints": {"slide4": {"position": 0, "std": 1}}},
            "joint 'slide4' of the prior is not in the model with a position of its own; it has slide",
        ),
        ({**GAUSSIAN, "joints": {"glue": {"position": 0, "std": 1}}}, "joint 'glue' of the prior is not in the model"),
        ({**GAUSSIAN, "joints": {"echo": {"position": 0, "std": 1}}}, "joint 'echo' of the prior is not in the model"),
        ({**GAUSSIAN, "joints": {"slide": {"position": 0}}}, "expected a finite 'position' and a 'std' above 0"),
        ({**GAUSSIAN, "joints": {"slide": 0.1}}, "joint 'slide' of the prior is 0.1; expected a finite"),
    ],
)
def test_what_is_said_of_a_prior_that_does_not_fit(
    model: ArticulatedObject, members: dict[str, object], said: str
) -> None:
    with pytest.raises(PriorError) as caught:
        load_prior(members, model)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_missing_or_no_object(model: ArticulatedObject, tmp_path: Path) -> None:
    with pytest.raises(PriorError, match=r"prior file 'none\.json' cannot be read: No such file"):
        load_prior(tmp_path / "none.json", model)
    (tmp_path / "list.json").write_text("[]")
    with pytest.raises(PriorError, match=r"prior file 'list\.json' holds a list; expected an object"):
        load_prior(tmp_path / "list.json", model)
