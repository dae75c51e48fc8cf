"""What does a link's surface look like? Triangles from mesh files and from URDF's primitives, in metres.

Mesh files are read from bytes, without a resolver: no texture, material or buffer outside the file is ever opened.
Coordinates are taken as ROS takes them: a COLLADA file's unit is applied, its up axis and glTF's are not, and the
transforms of the scene graph inside a file are.
"""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Iterable

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from pmpnbp.errors import ModelError
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.articulated_object import Mesh

# Flat faces with their corners on a round surface make a shape that is too small, and is found too near to the camera:
# corners lie so far outside that the volume is the round shape's. A sphere's faces stay within 0.7 % of its radius.
SPHERE_SUBDIVISIONS = 2
# A cylinder's corners stay within CORNERS radii over the square of their number; that is as large as keeps them within
# CLOSE metres, so that a thin handle has no more faces than can be told, or the most. A multiple of four keeps quarter
# turns what they are.
CORNERS, CLOSE, FEWEST_SEGMENTS, MOST_SEGMENTS = 3.5, 2.5e-4, 8, 32
# Vertices further out than this (metres) are damage, and would spoil every later bounding box.
MAX_COORDINATE = 1e5
# What Git LFS leaves in a file's place begins so.
LFS_POINTER = b"version https://git-lfs.github.com/spec/"

# Bytes that each kind of thing which is made of meshes is kept in: the next session on the same model starts at once.
KEPT = 64 * 2**20

EMPTY = Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32))


def content(meshes: Iterable[Mesh], *more: int) -> bytes:
    """A digest of all numbers in meshes, and of some others: a key to what is made of them."""
    digest = hashlib.blake2b(repr(more).encode(), digest_size=32)
    for mesh in meshes:
        for values in (mesh.vertices, mesh.faces):
            digest.update(repr((values.shape, values.dtype.str)).encode())
            digest.update(values.tobytes())
    return digest.digest()


def box(size: ArrayLike) -> Mesh:
    """A box of edge lengths `size` (3,) metres about the origin; 12 triangles."""
    return _from_trimesh(trimesh.creation.box(extents=np.asarray(size, dtype=np.float64)))


def cylinder(radius: float, length: float) -> Mesh:
    """A cylinder about the z axis, its middle at the origin; `radius` and `length` in metres."""
    quarter = np.ceil(np.sqrt(CORNERS * radius / CLOSE) / 4)
    sections = int(np.clip(4 * quarter, FEWEST_SEGMENTS, MOST_SEGMENTS))
    angle = 2 * np.pi / sections
    outside = radius * float(np.sqrt(angle / np.sin(angle)))
    return _from_trimesh(trimesh.creation.cylinder(radius=outside, height=length, sections=sections))


def sphere(radius: float) -> Mesh:
    """A sphere about the origin, `radius` in metres; 320 triangles."""
    ball = trimesh.creation.icosphere(subdivisions=SPHERE_SUBDIVISIONS, radius=1.0)
    return _from_trimesh(ball.apply_scale(radius * float(np.cbrt(4 / 3 * np.pi / ball.volume))))


def load_mesh(data: bytes, extension: str, what: str, triangle_limit: int) -> Mesh:
    """The triangles of a mesh file's bytes, in metres; `extension` is .stl, .obj, .dae, .glb or .ply.

    `what` names the mesh in errors. Raises ModelError where the file cannot be read, holds no triangle, a number that
    is not finite, or more than `triangle_limit` triangles.
    """
    if data.startswith(LFS_POINTER):
        raise ModelError(f"{what} is a Git LFS pointer, expected the mesh in its place: fetch it with `git lfs pull`")
    if extension == ".dae":
        _refuse_entities(data, what)
    try:
        scene = trimesh.load_scene(
            io.BytesIO(data), file_type=extension[1:], resolver=None, process=False, skip_materials=True
        )
        mesh = _flatten(scene, what, triangle_limit)
    except ModelError:
        raise
    except Exception as error:  # the readers behind trimesh raise whatever damaged bytes lead them to
        raise ModelError(f"{what} cannot be read: {_one_line(error)}") from None
    if len(mesh.faces) == 0:
        raise ModelError(f"{what} holds no triangle")
    if not np.all(np.abs(mesh.vertices) <= MAX_COORDINATE):  # false for NaN too
        raise ModelError(f"{what} holds a vertex that is not finite or further out than {MAX_COORDINATE:g} m")
    return mesh


def transformed(mesh: Mesh, pose: Array = poses.IDENTITY, scale: ArrayLike = 1.0) -> Mesh:
    """The mesh scaled by `scale` (a number or (3,)), then moved by `pose` (7,).

    A mirroring scale (a negative product) turns every face round, so that outward stays outward.
    """
    factors = np.broadcast_to(np.asarray(scale, dtype=np.float64), (3,))
    faces = mesh.faces[:, ::-1] if np.prod(np.sign(factors)) < 0 else mesh.faces
    return Mesh(poses.transform_points(pose, mesh.vertices * factors), np.ascontiguousarray(faces))


def joined(meshes: Iterable[Mesh]) -> Mesh:
    """All meshes as one."""
    pieces = list(meshes)
    if not pieces:
        return EMPTY
    starts = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    faces = [piece.faces + np.int32(start) for piece, start in zip(pieces, starts[:-1], strict=True)]
    return Mesh(np.concatenate([piece.vertices for piece in pieces]), np.concatenate(faces))


def welded(mesh: Mesh) -> Mesh:
    """The mesh with equal vertices made one, and triangles without area and vertices without triangle left out.

    Equal means to 1e-6 of the mesh's size: STL and COLLADA repeat every corner, and decimation needs them joined.
    """
    if len(mesh.faces) == 0:
        return EMPTY
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    grid = np.round((mesh.vertices - mesh.vertices.min(axis=0)) / max(extent * 1e-6, 1e-12)).astype(np.int64)
    # 21 bits hold an axis of 1e6 steps, so three axes make one sortable number.
    key = (grid[:, 0] << 42) | (grid[:, 1] << 21) | grid[:, 2]
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    faces = inverse[mesh.faces]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    corners = mesh.vertices[first][faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    faces = faces[whole & (area > 0)]
    used, packed = np.unique(faces, return_inverse=True)
    return Mesh(mesh.vertices[first][used], packed.reshape(-1, 3).astype(np.int32))


def _flatten(scene: trimesh.Scene, what: str, triangle_limit: int) -> Mesh:
    """All triangles of a scene graph, in the frame of its root, in metres."""
    instances = []
    count = 0
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        piece = scene.geometry[name]
        if not isinstance(piece, trimesh.Trimesh):
            continue
        count += len(piece.faces)
        if count > triangle_limit:  # before anything is copied: a small file can repeat a mesh very often
            raise ModelError(f"{what} holds more than {triangle_limit} triangles")
        instances.append((piece, np.asarray(matrix, dtype=np.float64)))
    pieces = []
    for piece, matrix in instances:
        vertices = (np.asarray(piece.vertices) @ matrix[:3, :3].T + matrix[:3, 3]) * _metres(piece)
        faces: NDArray[np.int32] = np.asarray(piece.faces, dtype=np.int32)
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise ModelError(f"{what} has a triangle between vertices that it does not have")
        mirrored = np.linalg.det(matrix[:3, :3]) < 0
        pieces.append(Mesh(vertices, faces[:, ::-1] if mirrored else faces))
    return joined(pieces)


def _refuse_entities(data: bytes, what: str) -> None:
    """No document type, and no encoding that could hide one: entities read files and grow without bound."""
    declared = re.search(rb"encoding\s*=\s*[\"']([^\"']*)", data[:200])
    encoding = declared[1].decode("ascii", "replace") if declared else "utf-8"
    if b"\0" in data[:64] or encoding.lower() not in ("utf-8", "utf8", "us-ascii", "ascii", "iso-8859-1"):
        raise ModelError(f"{what} is not encoded as UTF-8, ASCII or ISO-8859-1, the only encodings accepted")
    if re.search(rb"<!\s*(DOCTYPE|ENTITY)", data):
        raise ModelError(f"{what} has a DOCTYPE, which is not accepted: no document type and no entities")


def _metres(piece: trimesh.Trimesh) -> float:
    """A COLLADA file's unit, which trimesh notes as `0.01 * meters` and does not apply."""
    factor, _, unit = str(piece.metadata.get("units", "")).partition(" * ")
    return float(factor) if unit == "meters" else 1.0


def _from_trimesh(mesh: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int32))


def _one_line(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text[:200] or type(error).__name__
