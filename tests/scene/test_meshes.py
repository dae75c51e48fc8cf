"""Mesh files of every kind give the same triangles, in metres, facing outward; primitives are what they say."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pmpnbp.errors import ModelError
from pmpnbp.geometry import poses
from pmpnbp.scene.articulated_object import Mesh
from pmpnbp.scene.meshes import box, cylinder, joined, load_mesh, sphere, transformed, welded
from pmpnbp.scene.surface_points import even_points

KINDS = (".stl", ".obj", ".dae", ".glb", ".ply")


def volume(mesh: Mesh) -> float:
    """Of a closed surface, positive where its faces are counterclockwise from outside (the divergence theorem)."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return float(np.einsum("nd,nd->", a, np.cross(b, c)) / 6)


def wedge() -> trimesh.Trimesh:
    """No symmetry that could hide an exchange of axes; volume 1."""
    return trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def exported(shape: trimesh.Trimesh | trimesh.Scene, kind: str) -> bytes:
    data = shape.export(file_type=kind[1:])
    return data.encode() if isinstance(data, str) else data


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_file_gives_the_same_solid(kind: str) -> None:
    mesh = welded(load_mesh(exported(wedge(), kind), kind, "mesh", 10))
    assert (len(mesh.vertices), len(mesh.faces)) == (4, 4)
    assert volume(mesh) == pytest.approx(1)
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [1, 2, 3])


def test_a_glb_s_scene_graph_is_applied_and_its_up_axis_is_not() -> None:
    scene = trimesh.Scene()
    mirrored = np.diag([-1.0, 1.0, 1.0, 1.0])
    scene.add_geometry(wedge(), transform=trimesh.transformations.translation_matrix([10, 0, 0]))
    scene.add_geometry(wedge(), transform=mirrored)
    mesh = load_mesh(exported(scene, ".glb"), ".glb", "mesh", 10)
    np.testing.assert_allclose([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)], [[-1, 0, 0], [11, 2, 3]])
    assert volume(mesh) == pytest.approx(2)  # the mirrored one was turned inside out again


@pytest.mark.parametrize(("unit", "metres"), [("0.001", 0.001), ("0.0254", 0.0254), ("1", 1.0)])
def test_a_collada_file_s_unit_is_applied_and_its_up_axis_is_not(unit: str, metres: float) -> None:
    data = exported(wedge(), ".dae")
    head, tail = data.split(b"<asset>")
    asset = f'<asset><unit name="u" meter="{unit}"/><up_axis>Y_UP</up_axis>'.encode()
    rest = tail.split(b"</asset>", 1)[1]
    mesh = load_mesh(head + asset + b"</asset>" + rest, ".dae", "mesh", 10)
    np.testing.assert_allclose(mesh.vertices.max(axis=0), np.array([1, 2, 3]) * metres)


def test_a_mesh_s_material_and_texture_files_are_not_opened() -> None:
    """A texture that is no picture, inside the file, and material files that are not there."""
    obj = b"mtllib ../../secret.mtl\nusemtl m\n" + exported(wedge(), ".obj")
    assert len(load_mesh(obj, ".obj", "mesh", 10).faces) == 4


@pytest.mark.parametrize(
    ("data", "kind", "sentence"),
    [
        (b"", ".stl", "mesh holds no triangle"),
        (b"nonsense", ".glb", "mesh cannot be read: "),
        *(
            (
                b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 12345\n",
                kind,
                "mesh is a Git LFS pointer, expected the mesh in its place: fetch it with `git lfs pull`$",
            )
            for kind in (".stl", ".obj", ".dae")
        ),
        (b"v 0 0 0\n", ".obj", "mesh "),
        (b"solid x\nendsolid x\n", ".stl", "mesh "),
        (
            b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
            ".obj",
            "mesh holds a vertex that is not finite or further out than",
        ),
        (
            b"v 1e7 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
            ".obj",
            "mesh holds a vertex that is not finite or further out than",
        ),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", ".obj", "mesh "),
        (b'<!DOCTYPE x [<!ENTITY e "y">]><COLLADA/>', ".dae", "mesh has a DOCTYPE, which is not accepted"),
        (
            b'<?xml version="1.0" encoding="utf-7"?><COLLADA/>',
            ".dae",
            "mesh is not encoded as UTF-8, ASCII or ISO-8859",
        ),
        ("<COLLADA/>".encode("utf-16"), ".dae", "mesh is not encoded as UTF-8, ASCII or ISO-8859-1, the only"),
    ],
)
def test_unusable_files_are_named(data: bytes, kind: str, sentence: str) -> None:
    with pytest.raises(ModelError, match="^" + sentence) as caught:
        load_mesh(data, kind, "mesh", 10)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", KINDS)
def test_too_many_triangles(kind: str) -> None:
    with pytest.raises(ModelError, match=r"^mesh holds more than 3 triangles"):
        load_mesh(exported(wedge(), kind), kind, "mesh", 3)


def test_primitives_have_their_sizes_and_face_outward() -> None:
    np.testing.assert_allclose(np.ptp(box([1, 2, 3]).vertices, axis=0), [1, 2, 3])
    assert volume(box([1, 2, 3])) == pytest.approx(6)
    np.testing.assert_allclose(np.ptp(cylinder(0.5, 3).vertices, axis=0), [1, 1, 3], rtol=0.004)
    assert volume(cylinder(0.5, 3)) == pytest.approx(np.pi * 0.75)
    assert volume(sphere(2)) == pytest.approx(np.pi * 32 / 3)
    for mesh in (box([1, 2, 3]), cylinder(0.5, 3), sphere(2)):
        np.testing.assert_allclose((mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)), 0, atol=1e-12)


@pytest.mark.parametrize(("radius", "faces"), [(0.002, 32), (0.004, 32), (0.02, 80), (0.08, 128), (3.0, 128)])
def test_a_cylinder_has_no_more_faces_than_a_quarter_of_a_millimetre_asks_for(radius: float, faces: int) -> None:
    mesh = cylinder(radius, 0.3)
    assert len(mesh.faces) == faces
    assert volume(mesh) == pytest.approx(np.pi * radius**2 * 0.3)
    x, y, _ = mesh.vertices[np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1]) > 0].T
    assert 0 < (np.hypot(x, y) - radius).max() < max(2.5e-4, 0.0035 * radius)
    turned = {(round(-b / radius, 9) + 0.0, round(a / radius, 9) + 0.0) for a, b in zip(x, y, strict=True)}
    assert turned == {(round(a / radius, 9) + 0.0, round(b / radius, 9) + 0.0) for a, b in zip(x, y, strict=True)}


def test_round_primitives_lie_about_the_round_surface_as_far_within_as_beyond() -> None:
    from_middle = np.linalg.norm(even_points(sphere(2), 20_000), axis=1)
    assert from_middle.mean() == pytest.approx(2, rel=1e-4)
    assert 0.993 * 2 < from_middle.min() < 1.99 < 2.01 < from_middle.max() < 1.013 * 2
    side = even_points(cylinder(0.5, 3), 20_000)
    from_axis = np.linalg.norm(side[np.abs(side[:, 2]) < 1.499, :2], axis=1)
    assert from_axis.mean() == pytest.approx(0.5, rel=1e-4)
    assert 0.996 * 0.5 < from_axis.min() < from_axis.max() < 1.004 * 0.5


@pytest.mark.parametrize("scale", [2.0, (1, 2, 3), (-1, 1, 1), (-1, -2, 1), (-1, -1, -1)])
def test_scaling_multiplies_the_volume_and_never_turns_it_inside_out(scale: object) -> None:
    moved = transformed(box([1, 1, 1]), poses.from_xyz_rpy([1, 2, 3], [0.1, 0.2, 0.3]), scale)  # type: ignore[arg-type]
    assert volume(moved) == pytest.approx(abs(np.prod(np.broadcast_to(scale, 3))))  # type: ignore[call-overload]


def test_transforming_follows_composition(rng: np.random.Generator) -> None:
    a, b = np.concatenate([rng.normal(size=(2, 3)), poses.random_quaternions(rng, (2,))], axis=-1)
    at_once = transformed(box([1, 2, 3]), poses.multiply(a, b)).vertices
    np.testing.assert_allclose(transformed(transformed(box([1, 2, 3]), b), a).vertices, at_once, atol=1e-12)


def test_joining_adds_up() -> None:
    whole = joined([box([1, 1, 1]), transformed(sphere(1), scale=0.5), cylinder(1, 1)])
    assert len(whole.faces) == 12 + 320 + len(cylinder(1, 1).faces)
    assert volume(whole) == pytest.approx(1 + volume(sphere(0.5)) + volume(cylinder(1, 1)))
    assert len(joined([]).faces) == 0


def test_welding_joins_corners_and_leaves_out_what_has_no_area() -> None:
    solid = box([1, 1, 1])
    soup = Mesh(solid.vertices[solid.faces].reshape(-1, 3), np.arange(36, dtype=np.int32).reshape(-1, 3))
    spoiled = joined(
        [soup, Mesh(np.array([[0, 0, 0], [1, 1, 1], [0.5, 0.5, 0.5]]), np.array([[0, 1, 2], [0, 0, 1]], "i4"))]
    )
    mesh = welded(spoiled)
    assert (len(mesh.vertices), len(mesh.faces)) == (8, 12)
    assert volume(mesh) == pytest.approx(1)
    assert mesh.faces.dtype == np.int32
