"""Links become parts and joints edges as parts.py says, shown on small trees written as `parent kind child` lines."""

from __future__ import annotations

import numpy as np
import pytest

from pmpnbp.errors import ModelError
from pmpnbp.geometry import poses
from pmpnbp.scene.articulated_object import ArticulatedObject, Joint
from pmpnbp.scene.meshes import box
from pmpnbp.scene.parts import LinkSurface, assemble

ORIGIN = poses.from_xyz_rpy([0.3, -0.1, 0.2], [0.5, 0.1, -0.7])
SOLID = LinkSurface(exact=(box([0.1, 0.2, 0.3]),))


def tree(text: str) -> ArticulatedObject:
    """`a -r-> B, B -f-> c`: r, p, c and f are kinds; links with a capital letter have a surface. Joints are named by
    their child, in small letters."""
    kinds = {"r": "revolute", "p": "prismatic", "c": "continuous", "f": "fixed"}
    joints, links, dof = [], [], 0
    for line in text.split(","):
        parent, arrow, child = line.split()
        kind = kinds[arrow[1]]
        coordinates = () if kind == "fixed" else (dof,)
        dof += len(coordinates)
        axis = np.array([0.0, 0.6, 0.8])
        joints.append(Joint(child.lower(), kind, parent, child, ORIGIN, axis, -1.0, 1.0, coordinates))
        links += [parent, child]
    surfaces = {link: SOLID if link.isupper() else LinkSurface() for link in links}
    return assemble("t", links[0], tuple(joints), surfaces, 500, 1.0)


def shape(model: ArticulatedObject) -> tuple[list[str], list[str]]:
    """Each part's links, and each edge as parent part, coordinates, child part."""
    parts = ["".join(part.links) for part in model.parts]
    edges = [
        f"{model.parts[edge.parent].name} {' '.join(model.coordinate_names[k] for k in edge.coordinates)} "
        f"{model.parts[edge.child].name}"
        for edge in model.edges
    ]
    return parts, edges


@pytest.mark.parametrize(
    ("text", "parts", "edges"),
    [
        pytest.param("A -r-> B, B -p-> C", ["A", "B", "C"], ["A b B", "B c C"], id="chain"),
        pytest.param("A -f-> b, b -f-> C, b -r-> D", ["AbC", "D"], ["A d D"], id="fixed joints merge"),
        pytest.param("a -f-> B, B -r-> C", ["aB", "C"], ["B c C"], id="named by what can be seen"),
        pytest.param("A -r-> b, b -p-> C", ["A", "C"], ["A b c C"], id="passed through"),
        pytest.param("A -r-> b, b -f-> c, c -p-> d, d -c-> E", ["A", "E"], ["A b d e E"], id="passed through thrice"),
        pytest.param("w -p-> x, x -p-> y, y -c-> A, A -r-> B", ["A", "B"], ["A b B"], id="dropped above the first"),
        pytest.param("w -f-> A, A -r-> B", ["wA", "B"], ["A b B"], id="a fixed world is part of the first"),
        pytest.param("w -r-> A, w -r-> B", ["w", "A", "B"], ["w a A", "w b B"], id="a root that branches stays"),
        pytest.param(
            "A -r-> h, h -p-> B, h -p-> C", ["A", "h", "B", "C"], ["A h h", "h b B", "h c C"], id="a hub stays"
        ),
        pytest.param("A -r-> B, B -r-> t, t -p-> u", ["A", "B"], ["A b B"], id="unseen leaves go"),
        pytest.param("A -r-> h, h -p-> B, h -p-> t", ["A", "B"], ["A h b B"], id="a hub with one seen branch is none"),
        pytest.param("w -r-> t, w -r-> A", ["A"], [], id="a root with one seen branch goes"),
    ],
)
def test_links_become_parts_and_edges(text: str, parts: list[str], edges: list[str]) -> None:
    assert shape(tree(text)) == (parts, edges)


def test_every_moving_joint_keeps_its_coordinate() -> None:
    model = tree("w -c-> A, A -r-> t, A -p-> B")
    assert model.coordinate_names == ("a", "t", "b")
    np.testing.assert_allclose(model.lower, [-1, -1, -1])
    np.testing.assert_array_equal(model.wraps, [True, False, False])


TREES = (
    "w -p-> x, x -f-> y, y -c-> A, A -f-> b, b -r-> C, x -r-> z, C -r-> d, d -p-> E, E -r-> t, t -f-> u, A -p-> v",
    "A -r-> h, h -p-> B, h -p-> C, C -f-> t",
    "w -r-> A, w -r-> B, w -f-> v",
)


@pytest.mark.parametrize("text", TREES)
def test_parts_edges_and_link_poses_agree_with_joint_by_joint_kinematics(text: str, rng: np.random.Generator) -> None:
    model = tree(text)
    q = rng.uniform(-1, 1, size=(4, model.dof))
    root = np.concatenate([rng.normal(size=(4, 3)), poses.random_quaternions(rng, (4,))], axis=-1)
    direct = {model.links[0]: root}
    for joint in model.joints:
        direct[joint.child] = poses.multiply(direct[joint.parent], joint.pose_parent_child(q))
    part_poses = model.part_poses(direct[model.parts[0].links[0]], q)
    for k, part in enumerate(model.parts):
        np.testing.assert_allclose(
            poses.to_matrix(part_poses[:, k]), poses.to_matrix(direct[part.links[0]]), atol=1e-12
        )
    links = poses.to_matrix(model.link_poses(part_poses, q))
    expected = poses.to_matrix(np.stack([direct[link] for link in model.links], axis=-2))
    np.testing.assert_allclose(links, expected, atol=1e-12)


def test_a_link_of_a_part_is_where_its_part_is_even_off_the_joints(rng: np.random.Generator) -> None:
    """The belief of a part need not agree with the joint vector; only links that no part holds follow the joints."""
    model = tree("A -r-> b, b -p-> C, C -f-> d, C -r-> t")
    part_poses = np.concatenate([rng.normal(size=(2, 3)), poses.random_quaternions(rng, (2,))], axis=-1)
    q = rng.uniform(-1, 1, size=model.dof)
    found = dict(zip(model.links, model.link_poses(part_poses, q), strict=True))
    joint = {joint.child: joint for joint in model.joints}
    np.testing.assert_allclose(found["C"], part_poses[1])
    np.testing.assert_allclose(found["d"], poses.multiply(part_poses[1], ORIGIN))
    np.testing.assert_allclose(found["b"], poses.multiply(part_poses[0], joint["b"].pose_parent_child(q)))
    np.testing.assert_allclose(found["t"], poses.multiply(part_poses[1], joint["t"].pose_parent_child(q)))


def test_surfaces_of_fixed_links_are_moved_into_the_part_s_frame() -> None:
    part = tree("A -f-> B, B -f-> C").parts[0]
    corners = box([0.1, 0.2, 0.3]).vertices
    for k, pose in enumerate([poses.IDENTITY, ORIGIN, poses.multiply(ORIGIN, ORIGIN)]):
        np.testing.assert_allclose(part.poses_part_link[k], pose)
        np.testing.assert_allclose(part.mesh.vertices[8 * k : 8 * k + 8], poses.transform_points(pose, corners))


def test_a_part_without_surface_is_not_visible() -> None:
    hub = tree("A -r-> h, h -p-> B, h -p-> C").parts[1]
    assert not hub.visible
    np.testing.assert_array_equal(hub.centre, 0)


def test_a_model_without_any_surface_is_an_error() -> None:
    with pytest.raises(ModelError, match="no link of model 't' has visual or collision geometry"):
        tree("a -r-> b, b -f-> c")
