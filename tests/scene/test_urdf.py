"""Forward kinematics of loaded models against yourdfpy's and against matrices written out; meshes in their places."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yourdfpy
from scipy.spatial.transform import Rotation

from pmpnbp.errors import ModelError
from pmpnbp.geometry import poses
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.meshes import load_mesh
from pmpnbp.scene.model_files import ModelLimits
from pmpnbp.scene.urdf import load_model

BOX = '<visual><geometry><box size="0.1 0.2 0.3"/></geometry></visual>'


def link(name: str, inside: str = BOX) -> str:
    return f'<link name="{name}">{inside}</link>'


def joint(name: str, kind: str, parent: str, child: str, inside: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.1 -0.2 0.3" rpy="0.4 -0.5 0.6"/>{inside}</joint>'
    )


LIMIT = '<limit lower="-1" upper="1.5" effort="1" velocity="1"/>'
# Every kind that yourdfpy's own kinematics know, a mimic joint, a branch, and links without geometry at both ends.
COMMON = (
    '<robot name="common">'
    + link("world", "")
    + "".join(link(name) for name in ("base", "lid", "arm", "wheel", "finger", "thumb"))
    + link("tool", "")
    + joint("swing", "continuous", "world", "base", '<axis xyz="0 0 1"/>')
    + joint("hinge", "revolute", "base", "lid", f'<axis xyz="0 0.6 0.8"/>{LIMIT}')
    + joint("slide", "prismatic", "base", "arm", LIMIT)
    + joint("spin", "continuous", "arm", "wheel", '<axis xyz="0 0 -1"/>')
    + joint("weld", "fixed", "arm", "finger")
    + joint("follow", "prismatic", "finger", "thumb", f'{LIMIT}<mimic joint="hinge" multiplier="-0.5" offset="0.1"/>')
    + joint("tip", "revolute", "thumb", "tool", f'<axis xyz="1 0 0"/>{LIMIT}')
    + "</robot>"
)


@pytest.fixture
def load(tmp_path: Path) -> Callable[..., ArticulatedObject]:
    def from_text(text: str, **options: object) -> ArticulatedObject:
        path = tmp_path / "model.urdf"
        path.write_text(text)
        return load_model(path, **options)  # type: ignore[arg-type]

    return from_text


def yourdfpy_links(path: Path, model: ArticulatedObject, joint_positions: np.ndarray) -> np.ndarray:
    robot = yourdfpy.URDF.load(str(path), load_meshes=False)
    robot.update_cfg(dict(zip(model.coordinate_names, joint_positions, strict=True)))
    return np.stack([robot.get_transform(name, robot.base_link) for name in model.links])


def link_matrices(model: ArticulatedObject, root_link_pose: np.ndarray, joint_positions: np.ndarray) -> np.ndarray:
    """By way of the parts: the first part's pose from the root link's through the joints between, then all links."""
    pose = root_link_pose
    for step in path_to(model, model.parts[0].links[0]):
        pose = poses.multiply(pose, step.pose_parent_child(joint_positions))
    part_poses = model.part_poses(pose, joint_positions)
    return poses.to_matrix(model.link_poses(part_poses, joint_positions))


def path_to(model: ArticulatedObject, name: str) -> list:
    above = {step.child: step for step in model.joints}
    steps = []
    while name in above:
        steps.append(above[name])
        name = above[name].parent
    return steps[::-1]


def test_links_are_where_yourdfpy_puts_them(
    load: Callable[..., ArticulatedObject], tmp_path: Path, rng: np.random.Generator
) -> None:
    model = load(COMMON)
    for _ in range(10):
        q = rng.uniform(model.lower, model.upper)
        ours = link_matrices(model, poses.IDENTITY, q)
        np.testing.assert_allclose(ours, yourdfpy_links(tmp_path / "model.urdf", model, q), atol=1e-12)


def test_a_moved_root_moves_every_link(load: Callable[..., ArticulatedObject], rng: np.random.Generator) -> None:
    model = load(COMMON)
    q = rng.uniform(model.lower, model.upper)
    moved = poses.from_xyz_rpy([1.0, 2.0, 3.0], [0.1, 0.2, 0.3])
    at_origin = link_matrices(model, poses.IDENTITY, q)
    np.testing.assert_allclose(link_matrices(model, moved, q), poses.to_matrix(moved) @ at_origin, atol=1e-12)


def test_batches_give_what_single_vectors_give(
    load: Callable[..., ArticulatedObject], rng: np.random.Generator
) -> None:
    model = load(COMMON)
    q = rng.uniform(model.lower, model.upper, size=(2, 5, model.dof))
    root = np.concatenate([rng.normal(size=(5, 3)), poses.random_quaternions(rng, (5,))], axis=-1)
    links = model.link_poses(model.part_poses(root, q), q)
    assert links.shape == (2, 5, len(model.links), 7)
    for i, j in ((0, 0), (1, 3)):
        single = model.link_poses(model.part_poses(root[j], q[i, j]), q[i, j])
        np.testing.assert_allclose(links[i, j], single, atol=1e-12)
    values = model.joint_values(q)
    assert set(values) == {"swing", "hinge", "slide", "spin", "follow", "tip"}
    np.testing.assert_allclose(values["follow"][..., 0], -0.5 * values["hinge"][..., 0] + 0.1)
    np.testing.assert_array_equal(values["slide"][..., 0], q[..., model.coordinate_names.index("slide")])


def motion(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation
    return matrix


def test_planar_and_floating_joints_move_as_described(load: Callable[..., ArticulatedObject]) -> None:
    model = load(
        '<robot name="free">'
        + "".join(link(name) for name in "abc")
        + joint("plane", "planar", "a", "b", '<axis xyz="0 0 2"/>')
        + joint("free", "floating", "b", "c")
        + "</robot>",
        unlimited_range=0.7,
    )
    suffixes = ("x", "y", "z", "turn_x", "turn_y", "turn_z")
    assert model.coordinate_names == ("plane/x", "plane/y", "plane/turn", *(f"free/{name}" for name in suffixes))
    np.testing.assert_allclose(model.upper, [0.7, 0.7, np.pi, 0.7, 0.7, 0.7, np.pi, np.pi / 2, np.pi])
    np.testing.assert_allclose(model.lower, -model.upper)
    np.testing.assert_array_equal(model.wraps, [False, False, True, False, False, False, True, False, True])
    q = np.array([0.1, 0.2, 0.3, 0.4, -0.5, 0.6, 0.7, -0.8, 0.9])
    origin = motion(Rotation.from_euler("xyz", [0.4, -0.5, 0.6]).as_matrix(), np.array([0.1, -0.2, 0.3]))
    planar = motion(Rotation.from_euler("z", 0.3).as_matrix(), np.array([0.1, 0.2, 0.0]))
    floating = motion(Rotation.from_euler("XYZ", [0.7, -0.8, 0.9]).as_matrix(), np.array([0.4, -0.5, 0.6]))
    ours = link_matrices(model, poses.IDENTITY, q)
    np.testing.assert_allclose(ours[1], origin @ planar, atol=1e-12)
    np.testing.assert_allclose(ours[2], origin @ planar @ origin @ floating, atol=1e-12)
    assert [len(edge.axes) for edge in model.edges] == [3, 6]


@pytest.mark.parametrize("axis", ["1 0 0", "0 -1 0", "0 0 1", "1 2 3", "-3 0.1 0.1"])
def test_a_planar_joint_slides_across_its_axis(load: Callable[..., ArticulatedObject], axis: str) -> None:
    text = link("a") + link("b") + joint("plane", "planar", "a", "b", f'<axis xyz="{axis}"/>')
    plane = load(f'<robot name="p">{text}</robot>').joints[0]
    revolute, axes = plane.elementary_axes()
    np.testing.assert_array_equal(revolute, [False, False, True])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.cross(axes[0], axes[1]), axes[2], atol=1e-12)
    direction = np.array(axis.split(), dtype=float)
    np.testing.assert_allclose(axes[2], direction / np.linalg.norm(direction), atol=1e-12)


def mimics(follower: str, kind: str = "revolute", followed: str = LIMIT, third: str = "revolute") -> str:
    return (
        '<robot name="m">'
        + "".join(link(name) for name in "abcd")
        + joint("first", kind, "a", "b", followed)
        + joint("second", kind, "b", "c", follower)
        + joint("third", third, "c", "d", f'{LIMIT}<mimic joint="second" multiplier="2" offset="-0.5"/>')
        + "</robot>"
    )


def test_mimic_chains_are_resolved_and_limits_clipped(load: Callable[..., ArticulatedObject]) -> None:
    model = load(mimics('<limit lower="-0.2" upper="9"/><mimic joint="first" multiplier="-0.5" offset="0.25"/>'))
    assert model.coordinate_names == ("first",)
    second, third = model.edges[1], model.edges[2]
    # second = 0.25 - first / 2 over first in -1 … 1.5, which is -0.5 … 0.75; its own limits begin at -0.2
    np.testing.assert_allclose([second.lower[0], second.upper[0]], [-0.2, 0.75])
    # third = 2 second - 0.5 = -first, and first ends at 0.9, where second begins
    np.testing.assert_allclose([third.multiplier[0], third.offset[0]], [-1.0, 0.0])
    np.testing.assert_allclose([third.lower[0], third.upper[0]], [-0.9, 1.0])
    assert model.joints[2].mimic == "first"
    np.testing.assert_allclose(third.axis_positions(np.array([0.3])), [-0.3])


@pytest.mark.parametrize(("multiplier", "wraps"), [(1, True), (-1, True), (2, False), (0.5, False)])
def test_a_mimic_of_a_full_turn_wraps_if_it_turns_as_far(
    load: Callable[..., ArticulatedObject], multiplier: float, wraps: bool
) -> None:
    text = mimics(f'<mimic joint="first" multiplier="{multiplier}"/>', "continuous", "", "continuous")
    edge = load(text).edges[1]
    assert bool(edge.wraps[0]) is wraps
    np.testing.assert_allclose([edge.lower[0], edge.upper[0]], [-abs(multiplier) * np.pi, abs(multiplier) * np.pi])


def test_a_mimic_that_can_never_be_within_its_limits_is_an_error(load: Callable[..., ArticulatedObject]) -> None:
    text = mimics('<limit lower="3" upper="4"/><mimic joint="first"/>')
    with pytest.raises(ModelError, match=r"joint 'second' mimics 'first', which takes it to -1 … 1.5, wholly outside"):
        load(text)


@pytest.mark.parametrize(
    ("followers", "left"),
    [
        (['<limit lower="0" upper="0.05"/><mimic joint="k"/>'], (0.0, 0.05)),
        (['<limit lower="-0.2" upper="0"/><mimic joint="k" multiplier="-2"/>'], (0.0, 0.1)),
        (['<limit lower="0" upper="0.1"/><mimic joint="k" multiplier="-0.5" offset="0.2"/>'], (0.2, 0.3)),
        (
            ['<limit lower="-1" upper="0.2"/><mimic joint="k"/>', '<limit lower="0.1" upper="1"/><mimic joint="k"/>'],
            (0.1, 0.2),
        ),
        # through another, whose own limits count as well
        (
            ['<limit lower="0" upper="0.2"/><mimic joint="k"/>', '<limit lower="0" upper="0.1"/><mimic joint="f0"/>'],
            (0.0, 0.1),
        ),
        (['<limit lower="-9" upper="9"/><mimic joint="k"/>'], (0.0, 0.3)),
    ],
)
def test_a_joint_moves_no_further_than_those_that_follow_it_can(
    load: Callable[..., ArticulatedObject], followers: list[str], left: tuple[float, float]
) -> None:
    text = link("a") + link("b") + joint("k", "prismatic", "a", "b", '<limit lower="0" upper="0.3"/>')
    for number, inside in enumerate(followers):
        text += link(f"c{number}") + joint(f"f{number}", "prismatic", "a", f"c{number}", inside)
    model = load(f'<robot name="m">{text}</robot>')
    np.testing.assert_allclose([model.lower[0], model.upper[0]], left, atol=1e-12)
    for end in left:
        for name, position in model.joint_values(np.array([end])).items():
            limits = next(one for one in model.joints if one.name == name)
            assert limits.lower - 1e-12 <= position[0] <= limits.upper + 1e-12
    for one in model.joints[1:]:
        ends = sorted(one.multiplier * end + one.offset for end in left)
        np.testing.assert_allclose([one.lower, one.upper], ends, atol=1e-12)


def test_followers_that_turn_without_end_take_nothing_and_others_end_a_full_turn(
    load: Callable[..., ArticulatedObject],
) -> None:
    spin = joint("k", "continuous", "a", "b")
    free = link("c") + joint("f", "continuous", "a", "c", '<mimic joint="k" multiplier="0.5"/>')
    model = load(f'<robot name="m">{link("a")}{link("b")}{spin}{free}</robot>')
    np.testing.assert_allclose([model.lower[0], model.upper[0]], [-np.pi, np.pi])
    assert model.wraps.tolist() == [True]
    ended = link("d") + joint("g", "revolute", "a", "d", '<limit lower="-1" upper="2"/><mimic joint="k"/>')
    model = load(f'<robot name="m">{link("a")}{link("b")}{spin}{free}{ended}</robot>')
    np.testing.assert_allclose([model.lower[0], model.upper[0]], [-1, 2])
    assert model.wraps.tolist() == [False] and not any(edge.wraps.any() for edge in model.edges)
    assert [(one.kind, one.lower, one.upper) for one in model.joints] == [
        ("revolute", -1, 2),
        ("continuous", -0.5, 1),
        ("revolute", -1, 2),
    ]


def test_limits_that_leave_a_follower_one_position_are_passed_over(load: Callable[..., ArticulatedObject]) -> None:
    """As of a finger that mimics another by -1, with the same limits: those of the other sign are meant. The third
    one's still leave the first so much."""
    model = load(mimics('<limit lower="1.5" upper="4"/><mimic joint="first"/>'))
    assert [(one.lower, one.upper) for one in model.joints[:2]] == [(-0.25, 1.0), (-0.25, 1.0)]
    locked = mimics(
        '<limit lower="1.5" upper="1.5"/><mimic joint="first"/>', followed='<limit lower="1.5" upper="1.5"/>'
    )
    with pytest.raises(ModelError, match=r"joint 'third' mimics 'first', which takes it to 2.5 … 2.5, wholly outside"):
        load(locked)


def box(size: str, xyz: str = "0 0 0") -> str:
    return f'<visual><origin xyz="{xyz}"/><geometry><box size="{size}"/></geometry></visual>'


def moved(kind: str, xyz: str, inside: str = "") -> str:
    ends = f'<parent link="a"/><child link="b"/><origin xyz="{xyz}"/>'
    return f'{link("a")}{link("b")}<joint name="j" type="{kind}">{ends}{inside}</joint>'


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        (link("a", box("20100 1 1")), "the surface of link 'a' lies up to 10050 m from the root link 'a', expected"),
        (link("a", box("1 1 1", "0 0 -1e6")), "the surface of link 'a' lies up to 1e+06 m from"),
        (
            moved("fixed", "0 10001 0"),
            "joint 'j' takes link 'b' up to 10001 m from the root link 'a', expected at most",
        ),
        (moved("fixed", "0 9999.9 0"), "the surface of link 'b' lies up to 10000.1 m from the root link 'a'"),
        (
            moved("prismatic", "0 0 0", '<limit lower="-1e6" upper="1e6"/>'),
            "joint 'j' takes link 'b' up to 1e+06 m from the root link 'a', expected at most 10000",
        ),
        (moved("revolute", "5000 0 0", LIMIT) + link("c") + joint("k", "fixed", "b", "c"), None),
    ],
)
def test_an_object_that_reaches_too_far_is_an_error(
    load: Callable[..., ArticulatedObject], inside: str, said: str | None
) -> None:
    text = f'<robot name="far">{inside}</robot>'
    if said is None:
        assert load(text).dof == 1
        return
    with pytest.raises(ModelError) as caught:
        load(text)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_a_mimic_chain_beyond_all_size_is_an_error(load: Callable[..., ArticulatedObject]) -> None:
    text = mimics('<limit lower="-1" upper="1"/><mimic joint="first" multiplier="1e6"/>')
    with pytest.raises(ModelError, match=r"joint 'third' follows 'first' by 2e\+06 \* position"):
        load(text)


def test_default_axis_and_left_out_limit_are_those_of_urdf(load: Callable[..., ArticulatedObject]) -> None:
    text = link("a") + link("b") + joint("j", "prismatic", "a", "b", '<limit upper="0.3"/>')
    model = load(f'<robot name="d">{text}</robot>')
    np.testing.assert_array_equal(model.joints[0].axis, [1, 0, 0])
    np.testing.assert_array_equal([model.lower[0], model.upper[0]], [0, 0.3])


def test_the_text_is_kept_and_a_nameless_robot_goes_by_its_file(load: Callable[..., ArticulatedObject]) -> None:
    text = f"<robot><!-- kept -->{link('a')}</robot>"
    model = load(text)
    assert (model.urdf, model.name, model.dof) == (text, "model", 0)
    assert model.link_poses(model.part_poses(poses.IDENTITY, np.zeros(0)), np.zeros(0)).shape == (1, 7)


def placed(shape: str) -> str:
    return f'<visual><origin xyz="0 0 1" rpy="0 1.5707963267948966 0"/><geometry>{shape}</geometry></visual>'


def tetrahedron() -> trimesh.Trimesh:
    return trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def volume(mesh: object) -> float:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).volume  # type: ignore[attr-defined]


@pytest.mark.parametrize(("scale", "factor"), [("", 1), ('scale="0.5"', 0.125), ('scale="-1 2 1"', 2)])
def test_visual_origin_and_scale_place_a_mesh_and_keep_outward_outward(
    load: Callable[..., ArticulatedObject], tmp_path: Path, scale: str, factor: float
) -> None:
    tetrahedron().export(tmp_path / "t.stl")
    text = link("a", placed(f'<mesh filename="t.stl" {scale}/>'))
    mesh = load(f'<robot name="s">{text}</robot>').parts[0].mesh
    assert volume(mesh) == pytest.approx(factor)
    if not scale:  # turned by 90° about y: z goes to x, x to -z; then up by 1
        np.testing.assert_allclose(mesh.vertices.min(axis=0), [0, 0, 0], atol=1e-6)
        np.testing.assert_allclose(mesh.vertices.max(axis=0), [3, 2, 1], atol=1e-6)


def test_visuals_are_merged_and_collision_stands_in_where_there_is_none(load: Callable[..., ArticulatedObject]) -> None:
    two = BOX + '<visual><geometry><sphere radius="0.1"/></geometry></visual>'
    other = '<collision><geometry><cylinder radius="0.1" length="0.5"/></geometry></collision>'
    text = link("a", two + other) + link("b", other) + joint("j", "prismatic", "a", "b", LIMIT)
    first, second = load(f'<robot name="v">{text}</robot>').parts
    assert len(first.mesh.faces) == 12 + 320
    np.testing.assert_allclose(np.ptp(second.mesh.vertices, axis=0), [0.2, 0.2, 0.5], rtol=0.004)


def test_zip_and_file_give_the_same_model(load: Callable[..., ArticulatedObject], tmp_path: Path) -> None:
    tetrahedron().export(tmp_path / "t.stl")
    text = f'<robot name="z">{link("a", placed("""<mesh filename="package://robot/meshes/t.stl"/>"""))}</robot>'
    with zipfile.ZipFile(tmp_path / "model.zip", "w") as archive:
        archive.writestr("robot/urdf/z.urdf", text)
        archive.write(tmp_path / "t.stl", "robot/meshes/t.stl")
    zipped = load_model(tmp_path / "model.zip")
    flat = load(text.replace("package://robot/meshes/", ""))
    np.testing.assert_array_equal(zipped.parts[0].mesh.vertices, flat.parts[0].mesh.vertices)


def test_limits_on_links_and_triangles(load: Callable[..., ArticulatedObject]) -> None:
    with pytest.raises(ModelError, match="the URDF has 8 links, expected at most 7"):
        load(COMMON, limits=ModelLimits(links=7))
    with pytest.raises(ModelError, match="the model has more than 30 triangles, at link 'arm'"):
        load(COMMON, limits=ModelLimits(triangles=30))


@cache
def real_model(path: Path) -> ArticulatedObject:
    return load_model(path)


@pytest.mark.parametrize(
    ("model_name", "scan", "part_count"),
    [("fetch", "scan_0", 13), ("fetch", "scan_1", 13), ("real_xarm7", "frame_0", 8), ("real_xarm7", "frame_7", 8)],
)
def test_real_robots_links_are_at_their_true_poses(
    shared_data: Path, model_name: str, scan: str, part_count: int
) -> None:
    model = real_model(shared_data / model_name / "model.urdf")
    assert len(model.parts) == part_count
    assert all(len(part.inference_mesh.faces) <= 500 for part in model.parts)
    truth = json.loads((shared_data / model_name / scan / "truth.json").read_text())
    q = np.array([truth["joints"][name] for name in model.coordinate_names])
    true = np.array([truth["links"][name] for name in model.links])
    ours = link_matrices(model, poses.from_matrix(true[0]), q)
    np.testing.assert_allclose(ours, true, atol=2e-6)
    if model_name == "fetch":
        assert model.parts[0].name == "base_link"
        assert {"root", "root_arm_1_link_1", "root_arm_1_link_2"}.isdisjoint(model.parts[0].links)


@pytest.mark.parametrize("model_name", ["fetch", "real_xarm7"])
def test_real_meshes_agree_with_their_collision_meshes(shared_data: Path, model_name: str) -> None:
    """DAE and GLB, with their units, axes and scene graphs, stand where the STL and OBJ of the same links do."""
    compared = 0
    for seen in sorted((shared_data / model_name).rglob("*_link.dae")) + sorted(
        (shared_data / model_name / "meshes/visual").glob("*.glb")
    ):
        solid = seen.with_name(f"{seen.stem}_collision.STL")
        if seen.suffix == ".glb":
            solid = seen.parent.parent / "collision" / f"{seen.stem}.obj"
        if solid.exists():
            a, b = (load_mesh(f.read_bytes(), f.suffix.lower(), f.name, 10**6) for f in (seen, solid))
            np.testing.assert_allclose(a.vertices.min(axis=0), b.vertices.min(axis=0), atol=2e-3, err_msg=seen.name)
            np.testing.assert_allclose(a.vertices.max(axis=0), b.vertices.max(axis=0), atol=2e-3, err_msg=seen.name)
            compared += 1
    assert compared >= 8
