"""From a URDF, alone or in a zip with its meshes, to an articulated object. The only importer of yourdfpy."""

from __future__ import annotations

import io
import math
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import yourdfpy

from pmpnbp.errors import ModelError
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.scene import meshes
from pmpnbp.scene.articulated_object import ArticulatedObject, Joint, Mesh
from pmpnbp.scene.model_files import ModelFiles, ModelLimits, open_model
from pmpnbp.scene.parts import LinkSurface, assemble
from pmpnbp.scene.reach import FARTHEST
from pmpnbp.scene.urdf_check import MAX_MAGNITUDE, check_urdf

DEFAULT_LIMITS = ModelLimits()


def load_model(
    path: Path, *, triangle_budget: int = 500, unlimited_range: float = 1.0, limits: ModelLimits = DEFAULT_LIMITS
) -> ArticulatedObject:
    """Read a URDF file, or a zip holding one with its meshes.

    triangle_budget : triangles of a part's inference mesh
    unlimited_range : metres each way that planar and floating joints may slide, for which URDF has no limits
    limits : what the model may cost

    Raises ModelError, with one sentence, for anything that cannot be used.
    """
    with open_model(Path(path), limits) as files:
        checked = check_urdf(files.read_urdf(limits))
        # yourdfpy reads only what was checked, not the file.
        source = io.BytesIO(ElementTree.tostring(checked.tree))
        robot = yourdfpy.URDF.load(source, build_scene_graph=False, load_meshes=False).robot
        if len(robot.links) > limits.links:
            raise ModelError(f"the URDF has {len(robot.links)} links, expected at most {limits.links}")
        surfaces = _surfaces(robot, files, limits)
    joints = _with_coordinates(_joints(robot, unlimited_range))
    root = next(iter({link.name for link in robot.links} - {joint.child for joint in joints}))
    _check_reach(root, joints, surfaces)
    name = checked.name or Path(path).stem
    return assemble(name, root, joints, surfaces, triangle_budget, unlimited_range, checked.text)


def _joints(robot: yourdfpy.Robot, unlimited_range: float) -> list[Joint]:
    """Every joint, depth first from the root, siblings as in the file; no coordinates yet."""
    below: dict[str, list[yourdfpy.Joint]] = {link.name: [] for link in robot.links}
    for joint in robot.joints:
        below[joint.parent].append(joint)
    children = {joint.child for joint in robot.joints}
    waiting = [joint for link in robot.links if link.name not in children for joint in reversed(below[link.name])]
    ordered = []
    while waiting:
        joint = waiting.pop()
        ordered.append(_joint(joint, unlimited_range))
        waiting.extend(reversed(below[joint.child]))
    return ordered


def _joint(joint: yourdfpy.Joint, unlimited_range: float) -> Joint:
    lower, upper = {
        "fixed": (0.0, 0.0),
        "continuous": (-math.pi, math.pi),
        "planar": (-unlimited_range, unlimited_range),
        "floating": (-unlimited_range, unlimited_range),
    }.get(joint.type) or (joint.limit.lower, joint.limit.upper)
    return Joint(
        name=joint.name,
        kind=joint.type,
        parent=joint.parent,
        child=joint.child,
        pose_parent_joint=_pose(joint.origin),
        axis=np.asarray(joint.axis, dtype=np.float64),
        lower=lower,
        upper=upper,
        mimic=joint.mimic.joint if joint.mimic else None,
        multiplier=joint.mimic.multiplier if joint.mimic else 1.0,
        offset=joint.mimic.offset if joint.mimic else 0.0,
    )


def _with_coordinates(joints: list[Joint]) -> tuple[Joint, ...]:
    """Joints with their entries of the joint vector; mimic joints with those of the joint they follow in the end, which
    moves as far as the limits of all that follow it allow."""
    named = {joint.name: joint for joint in joints}
    resolved = [joint if joint.mimic is None else _resolved(joint, named) for joint in joints]
    leading = {joint.name: joint for joint in resolved if joint.mimic is None}
    for joint in resolved:
        if joint.mimic is not None and joint.kind != "continuous":
            leading[joint.mimic] = _narrowed(leading[joint.mimic], joint)
    start = 0
    for name, joint in leading.items():
        count = {"fixed": 0, "planar": 3, "floating": 6}.get(joint.kind, 1)
        leading[name] = replace(joint, coordinates=tuple(range(start, start + count)))
        start += count
    return tuple(leading.get(joint.name) or _following(joint, leading[joint.mimic or ""]) for joint in resolved)


def _resolved(joint: Joint, named: dict[str, Joint]) -> Joint:
    """A mimic joint by what the joint does that it follows in the end."""
    multiplier, offset, followed = joint.multiplier, joint.offset, named[joint.mimic or ""]
    while followed.mimic is not None:
        multiplier, offset = multiplier * followed.multiplier, multiplier * followed.offset + offset
        followed = named[followed.mimic]
        if max(abs(multiplier), 1 / abs(multiplier), abs(offset)) > MAX_MAGNITUDE:
            raise ModelError(
                f"joint '{joint.name}' follows '{followed.name}' by {multiplier:g} * position + {offset:g}, expected "
                f"numbers between {1 / MAX_MAGNITUDE:g} and {MAX_MAGNITUDE:g} in size"
            )
    return replace(joint, mimic=followed.name, multiplier=multiplier, offset=offset)


def _narrowed(followed: Joint, joint: Joint) -> Joint:
    """The followed joint, with as much of its range as keeps `joint` within its own limits. A continuous one that does
    not turn all the way any more is revolute: its two ends are not one place."""
    low, high = _taken_to(joint, followed)
    ends = sorted((end - joint.offset) / joint.multiplier for end in (joint.lower, joint.upper))
    lower, upper = max(followed.lower, ends[0]), min(followed.upper, ends[1])
    if lower > upper:
        raise ModelError(
            f"joint '{joint.name}' mimics '{followed.name}', which takes it to {low:g} … {high:g}, wholly outside its "
            f"own limits {joint.lower:g} … {joint.upper:g}"
        )
    # limits that meet in one position are most often those of a multiplier of the other sign, as of grippers' fingers
    if lower == upper or (lower, upper) == (followed.lower, followed.upper):
        return followed
    kind = "revolute" if followed.kind == "continuous" else followed.kind
    return replace(followed, kind=kind, lower=lower, upper=upper)


def _following(joint: Joint, followed: Joint) -> Joint:
    lower, upper = _taken_to(joint, followed)
    own = max(joint.lower, lower), min(joint.upper, upper)
    if joint.kind != "continuous" and own[0] < own[1]:  # they differ by rounding alone
        lower, upper = own
    return replace(joint, coordinates=followed.coordinates, lower=lower, upper=upper)


def _taken_to(joint: Joint, followed: Joint) -> tuple[float, float]:
    """The range of a mimic joint by that of the joint it follows."""
    lower, upper = sorted(joint.multiplier * end + joint.offset for end in (followed.lower, followed.upper))
    return lower, upper


def _check_reach(root: str, joints: tuple[Joint, ...], surfaces: dict[str, LinkSurface]) -> None:
    """Whether every link and its surface stay within FARTHEST of the root link, however joints are moved."""
    reach = {root: 0.0}
    for joint in joints:
        revolute, _ = joint.elementary_axes()
        slides = np.max(np.abs(joint.limits()), axis=0)[~revolute]
        reach[joint.child] = reach[joint.parent] + math.hypot(*joint.pose_parent_joint[:3]) + math.hypot(*slides)
        if reach[joint.child] > FARTHEST:
            raise ModelError(
                f"joint '{joint.name}' takes link '{joint.child}' up to {reach[joint.child]:.6g} m from the root link "
                f"'{root}', expected at most {FARTHEST:g}"
            )
    for link, surface in surfaces.items():
        vertices = [mesh.vertices for mesh in (*surface.exact, *surface.scanned)]
        far = reach[link] + max((np.linalg.norm(one, axis=-1).max() for one in vertices), default=0.0)
        if far > FARTHEST:
            raise ModelError(
                f"the surface of link '{link}' lies up to {far:.6g} m from the root link '{root}', expected at most "
                f"{FARTHEST:g}"
            )


def _surfaces(robot: yourdfpy.Robot, files: ModelFiles, limits: ModelLimits) -> dict[str, LinkSurface]:
    """Each link's surface in its own frame: its visual geometry, or its collision geometry where it has no other."""
    cache: dict[str, Mesh] = {}
    left = limits.triangles
    surfaces = {}
    for link in robot.links:
        exact, scanned = [], []
        for shape in link.visuals or link.collisions:
            geometry, pose = shape.geometry, _pose(shape.origin)
            if geometry.mesh is not None:
                mesh = _mesh_file(geometry.mesh.filename, link.name, files, limits, cache)
                scale = 1.0 if geometry.mesh.scale is None else geometry.mesh.scale
                scanned.append(meshes.transformed(mesh, pose, scale))
                left -= len(mesh.faces)
            else:
                exact.append(meshes.transformed(_primitive(geometry), pose))
                left -= len(exact[-1].faces)
            if left < 0:
                raise ModelError(f"the model has more than {limits.triangles} triangles, at link '{link.name}'")
        surfaces[link.name] = LinkSurface(tuple(exact), tuple(scanned))
    return surfaces


def _mesh_file(filename: str, link: str, files: ModelFiles, limits: ModelLimits, cache: dict[str, Mesh]) -> Mesh:
    if filename not in cache:
        data = files.read_mesh(filename, link, limits)
        what = f"mesh '{filename}' of link '{link}'"
        cache[filename] = meshes.welded(meshes.load_mesh(data, Path(filename).suffix.lower(), what, limits.triangles))
        if len(cache[filename].faces) == 0:
            raise ModelError(f"{what} holds no triangle with an area")
    return cache[filename]


def _primitive(geometry: yourdfpy.Geometry) -> Mesh:
    if geometry.box is not None:
        return meshes.box(geometry.box.size)
    if geometry.cylinder is not None:
        return meshes.cylinder(geometry.cylinder.radius, geometry.cylinder.length)
    return meshes.sphere(geometry.sphere.radius)


def _pose(matrix: Array | None) -> Array:
    return poses.IDENTITY if matrix is None else poses.from_matrix(matrix)
