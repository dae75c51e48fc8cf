"""Which links move as one, and by what motion is each such part joined to the next? Links and joints → MRF.

Links held together by fixed joints form a group. A group becomes a part, but for three kinds without any surface:

- one that nothing with a surface hangs on (a tool frame behind a moving joint) is left out, as nothing can show where
  it is; its joint's coordinate stays in the joint vector;
- one at the root with a single moving joint below (a world frame above a mobile base) is left out too, as the pose of
  the part below is free anyway;
- one between a single moving joint above and a single one below passes motion on: both joints become one edge.

A group without surface that several moving parts hang on stays a part, the only thing that ties them together.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pmpnbp.errors import ModelError
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.articulated_object import ArticulatedObject, Edge, Joint, Mesh, Part
from pmpnbp.scene.decimation import reduced
from pmpnbp.scene.meshes import transformed


@dataclass(frozen=True)
class LinkSurface:
    """A link's triangles in the link's frame. exact : primitives; scanned : meshes from files."""

    exact: tuple[Mesh, ...] = ()
    scanned: tuple[Mesh, ...] = ()

    @property
    def visible(self) -> bool:
        """Whether there is any."""
        return bool(self.exact or self.scanned)


@dataclass
class _Group:
    """Links fixed to each other, from the root down, each with its pose in the first one's frame; and the moving
    joints that lead on."""

    poses_group_link: dict[str, Array]
    visible: bool
    moving: list[Joint] = field(default_factory=list)


def assemble(
    name: str,
    root: str,
    joints: tuple[Joint, ...],
    surfaces: Mapping[str, LinkSurface],
    triangle_budget: int,
    unlimited_range: float,
    urdf: str = "",
) -> ArticulatedObject:
    """The object of `joints` (depth first from link `root`, with their coordinates) and each link's surface.

    Raises ModelError where no link has a surface.
    """
    groups = _groups(root, joints, surfaces)
    _drop_unseen_leaves(root, groups)
    first = root
    while not groups[first].visible:
        if not groups[first].moving:
            raise ModelError(f"no link of model '{name}' has visual or collision geometry")
        if len(groups[first].moving) > 1:
            break
        first = groups[first].moving[0].child

    coordinate_names, lower, upper, wraps = _joint_vector(joints, unlimited_range)
    parts = [_part(groups[first], surfaces, triangle_budget)]
    edges = []
    waiting = [(0, [joint]) for joint in reversed(groups[first].moving)]
    while waiting:
        parent, chain = waiting.pop()
        group = groups[chain[-1].child]
        if not group.visible and len(group.moving) == 1:
            waiting.append((parent, [*chain, group.moving[0]]))
            continue
        edges.append(_edge(parent, len(parts), chain, groups, lower, upper, wraps))
        waiting.extend((len(parts), [joint]) for joint in reversed(group.moving))
        parts.append(_part(group, surfaces, triangle_budget))
    return ArticulatedObject(
        name=name,
        parts=tuple(parts),
        edges=tuple(edges),
        joints=joints,
        links=(root, *(joint.child for joint in joints)),
        coordinate_names=coordinate_names,
        lower=lower,
        upper=upper,
        wraps=wraps,
        urdf=urdf,
    )


def _groups(root: str, joints: tuple[Joint, ...], surfaces: Mapping[str, LinkSurface]) -> dict[str, _Group]:
    """Every group, by each of its links."""
    groups = {root: _Group({root: poses.IDENTITY}, surfaces[root].visible)}
    for joint in joints:
        above = groups[joint.parent]
        if joint.kind == "fixed":
            pose = poses.multiply(above.poses_group_link[joint.parent], joint.pose_parent_joint)
            above.poses_group_link[joint.child] = pose
            above.visible |= surfaces[joint.child].visible
            groups[joint.child] = above
        else:
            above.moving.append(joint)
            groups[joint.child] = _Group({joint.child: poses.IDENTITY}, surfaces[joint.child].visible)
    return groups


def _drop_unseen_leaves(root: str, groups: dict[str, _Group]) -> None:
    ordered = [groups[root]]
    for group in ordered:  # grows while it is walked
        ordered.extend(groups[joint.child] for joint in group.moving)
    for group in reversed(ordered):
        group.moving[:] = [joint for joint in group.moving if groups[joint.child].visible or groups[joint.child].moving]


def _part(group: _Group, surfaces: Mapping[str, LinkSurface], triangle_budget: int) -> Part:
    links = tuple(group.poses_group_link)
    exact: list[Mesh] = []
    scanned: list[Mesh] = []
    for link, pose in group.poses_group_link.items():
        exact.extend(transformed(mesh, pose) for mesh in surfaces[link].exact)
        scanned.extend(transformed(mesh, pose) for mesh in surfaces[link].scanned)
    mesh, inference_mesh, deviation = reduced(exact, scanned, triangle_budget)
    return Part(
        name=next((link for link in links if surfaces[link].visible), links[0]),
        links=links,
        poses_part_link=np.stack(list(group.poses_group_link.values())),
        mesh=mesh,
        inference_mesh=inference_mesh,
        deviation=deviation,
    )


def _edge(
    parent: int,
    child: int,
    chain: list[Joint],
    groups: dict[str, _Group],
    lower: Array,
    upper: Array,
    wraps: NDArray[np.bool_],
) -> Edge:
    """The edge of a chain of moving joints. What follows a joint starts at its child link, which is the first of the
    next group, so the chain's end is the child part's frame itself."""
    before: list[Array] = []
    revolute: list[bool] = []
    axes: list[Array] = []
    low: list[float] = []
    high: list[float] = []
    full: list[bool] = []
    for joint in chain:
        turns, directions = joint.elementary_axes()
        start = poses.multiply(groups[joint.parent].poses_group_link[joint.parent], joint.pose_parent_joint)
        before.extend([start, *[poses.IDENTITY] * (len(turns) - 1)])
        revolute.extend(turns)
        axes.extend(directions)
        entries = list(joint.coordinates)
        if joint.mimic is None:
            low.extend(lower[entries])
            high.extend(upper[entries])
            full.extend(wraps[entries])
        else:
            low.append(joint.lower)
            high.append(joint.upper)
            full.append(joint.kind == "continuous" and abs(joint.multiplier) == 1 and wraps[entries[0]])
    return Edge(
        parent=parent,
        child=child,
        poses_before=np.stack(before),
        pose_after=poses.IDENTITY,
        revolute=np.array(revolute, dtype=np.bool_),
        axes=np.stack(axes),
        lower=np.array(low, dtype=np.float64),
        upper=np.array(high, dtype=np.float64),
        wraps=np.array(full, dtype=np.bool_),
        coordinates=np.array([entry for joint in chain for entry in joint.coordinates], dtype=np.int64),
        multiplier=np.array([joint.multiplier for joint in chain for _ in joint.coordinates]),
        offset=np.array([joint.offset for joint in chain for _ in joint.coordinates]),
    )


def _joint_vector(
    joints: tuple[Joint, ...], unlimited_range: float
) -> tuple[tuple[str, ...], Array, Array, NDArray[np.bool_]]:
    """Names, lower, upper and wraps of the joint vector's entries."""
    slide, turn, half = (unlimited_range, False), (math.pi, True), (math.pi / 2, False)
    names: list[str] = []
    lower: list[float] = []
    upper: list[float] = []
    wraps: list[bool] = []
    for joint in joints:
        if joint.mimic is not None or joint.kind == "fixed":
            continue
        if joint.kind in ("planar", "floating"):
            planar = joint.kind == "planar"
            # The middle of three turns needs half a turn to reach every rotation once.
            ranges = (slide, slide, turn) if planar else (slide, slide, slide, turn, half, turn)
            suffixes = ("x", "y", "turn") if planar else ("x", "y", "z", "turn_x", "turn_y", "turn_z")
            for suffix, (reach, full) in zip(suffixes, ranges, strict=True):
                names.append(f"{joint.name}/{suffix}")
                lower.append(-reach)
                upper.append(reach)
                wraps.append(full)
        else:
            names.append(joint.name)
            lower.append(joint.lower)
            upper.append(joint.upper)
            wraps.append(joint.kind == "continuous")
    return tuple(names), np.array(lower), np.array(upper), np.array(wraps, dtype=np.bool_)
