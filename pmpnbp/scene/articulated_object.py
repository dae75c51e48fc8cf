"""The articulated object: rigid parts, the joints between them, and where every part is for given joint positions.

Links that `fixed` joints hold together move as one and are one **part**, a node of the Markov random field. A link
without geometry cannot be seen: where it only passes motion on (one moving joint above, one below), its two joints
form one **edge** between the parts they connect. So an edge is a chain of one or more elementary axes, each of which
slides or turns; a planar joint is three of them, a floating joint six, a mimic joint one whose coordinate is another
joint's.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array


@dataclass(frozen=True)
class Mesh:
    """Triangles. vertices : (V, 3) float64, metres; faces : (F, 3) int32, indices into vertices, outward by the
    right-hand rule where the file was so."""

    vertices: Array
    faces: NDArray[np.int32]


@dataclass(frozen=True)
class Part:
    """Links fixed to each other, a node of the MRF.

    name : that of its first link with geometry, from the root down
    links : names of all its links
    poses_part_link : (L, 7), each link in the part's frame, which is that of the first of `links`
    mesh : all visual geometry (collision geometry where there is no visual one), in the part's frame; no faces where
        the part has no geometry, and then its unary potential is 1 everywhere
    inference_mesh : the same, reduced to a triangle budget
    deviation : largest distance between `inference_mesh` and what of `mesh` is seen from outside, both ways, metres
    """

    name: str
    links: tuple[str, ...]
    poses_part_link: Array
    mesh: Mesh
    inference_mesh: Mesh
    deviation: float

    @property
    def visible(self) -> bool:
        """Whether the part has any surface."""
        return len(self.mesh.faces) > 0

    @property
    def centre(self) -> Array:
        """(3,): the middle of the part's bounding box, in the part's frame; zero without geometry."""
        if not self.visible:
            return np.zeros(3)
        used = self.mesh.vertices
        return (used.min(axis=0) + used.max(axis=0)) / 2

    @property
    def extents(self) -> Array:
        """(3,) metres: the sides of the part's bounding box, along the part's axes; zero without geometry."""
        sides: Array = np.ptp(self.mesh.vertices, axis=0) if len(self.mesh.vertices) else np.zeros(3)
        return sides


@dataclass(frozen=True)
class Joint:
    """A joint of the URDF.

    kind : fixed, revolute, continuous, prismatic, planar or floating
    pose_parent_joint : (7,), its frame in the parent link's; axis : (3,), unit vector in that frame
    lower, upper : metres or radians; -pi and pi for continuous; for planar and floating of the slides; for a mimic
        joint that part of its limits which the followed joint can take it to; of a followed joint what the limits of
        those that follow it leave
    coordinates : its entries of the object's joint vector (none for fixed; those of the followed joint for mimic)
    mimic, multiplier, offset : the joint it follows (through any that follow others in turn), moving by
        multiplier * position + offset
    """

    name: str
    kind: str
    parent: str
    child: str
    pose_parent_joint: Array
    axis: Array
    lower: float
    upper: float
    coordinates: tuple[int, ...] = ()
    mimic: str | None = None
    multiplier: float = 1.0
    offset: float = 0.0

    def elementary_axes(self) -> tuple[NDArray[np.bool_], Array]:
        """The slides and turns it is made of, in order: revolute (K,) bool, axes (K, 3) in the joint's frame.

        Planar: two slides across the axis (along x and y where the axis is z), then a turn about it. Floating: slides
        along x, y, z, then turns about x, y, z, each about the axes as the turns before have left them.
        """
        if self.kind == "floating":
            return np.array([False] * 3 + [True] * 3), np.concatenate([np.eye(3), np.eye(3)])
        if self.kind == "planar":
            following = np.eye(3)[(int(np.abs(self.axis).argmax()) + 1) % 3]
            first = following - self.axis * (following @ self.axis)
            first /= np.linalg.norm(first)
            return np.array([False, False, True]), np.stack([first, np.cross(self.axis, first), self.axis])
        if self.kind == "fixed":
            return np.zeros(0, dtype=np.bool_), np.zeros((0, 3))
        return np.array([self.kind != "prismatic"]), self.axis[None]

    def limits(self) -> tuple[Array, Array]:
        """(n,), (n,) lower and upper limits of the elementary axes, metres or radians. Those of a planar or floating
        joint are its slides'; its turns are free."""
        revolute, _ = self.elementary_axes()
        free = revolute & (len(revolute) > 1)
        return np.where(free, -np.pi, self.lower), np.where(free, np.pi, self.upper)

    def positions(self, joint_positions: Array) -> Array:
        """(..., K): how far each of its elementary axes is moved at the joint vector (..., D)."""
        return self.multiplier * joint_positions[..., list(self.coordinates)] + self.offset

    def pose_parent_child(self, joint_positions: Array) -> Array:
        """Poses (..., 7) of the child link in the parent link at the joint vector (..., D)."""
        revolute, axes = self.elementary_axes()
        moved = self.positions(joint_positions)
        pose = np.broadcast_to(self.pose_parent_joint, (*moved.shape[:-1], 7))
        for k in range(len(axes)):
            pose = poses.multiply(pose, axis_motion(bool(revolute[k]), axes[k], moved[..., k]))
        return pose


@dataclass(frozen=True)
class Edge:
    """The motion between two parts: pose_parent_child = before_0 * motion_0(q) * before_1 * motion_1(q) … * after.

    parent, child : indices of parts
    poses_before : (K, 7); pose_after : (7,)
    revolute : (K,) bool, else prismatic
    axes : (K, 3) unit vectors, in the frame after poses_before
    lower, upper : (K,), metres or radians, of the axis itself (multiplier and offset of a mimic joint applied)
    wraps : (K,) bool, a full turn whose two ends are the same place
    coordinates : (K,) int, entries of the joint vector
    multiplier, offset : (K,): the axis moves by multiplier * q[coordinate] + offset (1 and 0 but for mimic joints)
    """

    parent: int
    child: int
    poses_before: Array
    pose_after: Array
    revolute: NDArray[np.bool_]
    axes: Array
    lower: Array
    upper: Array
    wraps: NDArray[np.bool_]
    coordinates: NDArray[np.int64]
    multiplier: Array
    offset: Array

    def axis_positions(self, joint_positions: Array) -> Array:
        """(..., K): how far each axis is moved when the object's joint vector is `joint_positions` (..., D)."""
        return self.multiplier * joint_positions[..., self.coordinates] + self.offset

    def joint_positions(self, axis_positions: Array) -> tuple[NDArray[np.int64], Array]:
        """What axis positions (..., K) say of the joint vector: the entries (M,) that move an axis, and their positions
        (..., M)."""
        moving = self.multiplier != 0
        return self.coordinates[moving], (axis_positions - self.offset)[..., moving] / self.multiplier[moving]

    def pose_parent_child(self, axis_positions: Array) -> Array:
        """Poses (..., 7) of the child in the parent for axis positions (..., K)."""
        pose = np.broadcast_to(poses.IDENTITY, (*axis_positions.shape[:-1], 7))
        for k in range(len(self.axes)):
            pose = poses.multiply(pose, self.poses_before[..., k, :])
            pose = poses.multiply(pose, axis_motion(self.revolute[k], self.axes[k], axis_positions[..., k]))
        return poses.multiply(pose, self.pose_after)


def axis_motion(revolute: bool, axis: Array, position: Array) -> Array:
    """Poses (..., 7): a turn by `position` radians about `axis` (3,), or a slide by `position` metres along it."""
    vector = np.asarray(position)[..., None] * axis
    if revolute:
        return np.concatenate([np.zeros_like(vector), poses.from_rotation_vector(vector)], axis=-1)
    identity = np.broadcast_to(poses.IDENTITY[3:], (*vector.shape[:-1], 4))
    return np.concatenate([vector, identity], axis=-1)


@dataclass(frozen=True)
class ArticulatedObject:
    """A robot, a cabinet, a lamp: what a URDF describes, ready for inference.

    parts : the nodes; parts[0] is the root of the tree
    edges : N - 1 of them for a URDF, each after the edge that reaches its parent
    joints : every joint of the URDF, fixed ones too, from the root down (depth first)
    links : every link's name, from the root down (depth first); those without geometry may be in no part
    coordinate_names, lower, upper, wraps : (D,) the joint vector: `joint`, or `joint/x` for joints with several
    urdf : its text
    sizes : (3,) how much larger it is than its URDF says, shares along the root part's axes; see `scene/sizes.py`
    """

    name: str
    parts: tuple[Part, ...]
    edges: tuple[Edge, ...]
    joints: tuple[Joint, ...]
    links: tuple[str, ...]
    coordinate_names: tuple[str, ...]
    lower: Array
    upper: Array
    wraps: NDArray[np.bool_]
    urdf: str = field(default="", repr=False)
    sizes: Array = field(default_factory=lambda: np.zeros(3))

    @property
    def dof(self) -> int:
        """Length D of the joint vector."""
        return len(self.coordinate_names)

    def part_poses(self, pose_world_root: Array, joint_positions: Array) -> Array:
        """Forward kinematics over the tree: part poses (..., N, 7) from the root part's pose (..., 7) and the joint
        vector (..., D). Edges beyond the tree (a closed loop) are not used."""
        shape = np.broadcast_shapes(pose_world_root.shape[:-1], joint_positions.shape[:-1])
        found: dict[int, Array] = {0: np.broadcast_to(pose_world_root, (*shape, 7))}
        for edge in self.edges:
            if edge.child not in found:
                relative = edge.pose_parent_child(edge.axis_positions(joint_positions))
                found[edge.child] = poses.multiply(found[edge.parent], relative)
        return np.stack([found[part] for part in range(len(self.parts))], axis=-2)

    def link_poses(self, part_poses: Array, joint_positions: Array) -> Array:
        """Poses (..., L, 7) of every link, in the order of `links`, from part poses (..., N, 7) and the joint vector
        (..., D).

        A link that belongs to a part is where its part is. Any other follows from the nearest link that has a pose,
        through the joints between: upwards from the first part, downwards everywhere else.
        """
        shape = np.broadcast_shapes(part_poses.shape[:-2], joint_positions.shape[:-1])
        found: dict[str, Array] = {}
        for index, part in enumerate(self.parts):
            for place, link in enumerate(part.links):
                found[link] = poses.multiply(part_poses[..., index, :], part.poses_part_link[..., place, :])
        above = self._above_first_part()
        for joint in reversed(self.joints):
            if joint.child in above and joint.parent not in found:
                relative = poses.inverse(joint.pose_parent_child(joint_positions))
                found[joint.parent] = poses.multiply(found[joint.child], relative)
        for joint in self.joints:
            if joint.child not in found:
                found[joint.child] = poses.multiply(found[joint.parent], joint.pose_parent_child(joint_positions))
        return np.stack([np.broadcast_to(found[link], (*shape, 7)) for link in self.links], axis=-2)

    def joint_values(self, joint_positions: Array) -> dict[str, Array]:
        """Positions (..., n) of every joint that moves, mimic joints too, by name, from the joint vector (..., D);
        n is 1, or 3 for planar and 6 for floating joints."""
        return {joint.name: joint.positions(joint_positions) for joint in self.joints if joint.kind != "fixed"}

    def edge_joints(self, edge: Edge) -> tuple[Joint, ...]:
        """The moving joints that an edge is made of, from parent to child: its axes are theirs, one after the other."""
        above = {joint.child: joint for joint in self.joints}
        links = self.parts[edge.parent].links
        joint = above[self.parts[edge.child].links[0]]
        chain = [joint]
        while joint.parent not in links:
            joint = above[joint.parent]
            chain.append(joint)
        return tuple(joint for joint in reversed(chain) if joint.kind != "fixed")

    def edge_axis_names(self, edge: Edge) -> tuple[str, ...]:
        """(K,) what each axis of an edge is called: `joint`, or `joint/x` for joints with several. A mimic joint's has
        its own name, not that of the coordinate it shares."""
        return tuple(
            joint.name if len(joint.coordinates) == 1 else self.coordinate_names[entry]
            for joint in self.edge_joints(edge)
            for entry in joint.coordinates
        )

    def _above_first_part(self) -> set[str]:
        """The first part's own first link, and all links that lead to it from the root."""
        parent = {joint.child: joint.parent for joint in self.joints}
        link: str | None = self.parts[0].links[0]
        chain = set()
        while link is not None:
            chain.add(link)
            link = parent.get(link)
        return chain


def parts_of_links(model: ArticulatedObject) -> dict[str, int]:
    """For every link the part it is in, or else that which `ArticulatedObject.link_poses` reaches it from."""
    owner = {link: index for index, part in enumerate(model.parts) for link in part.links}
    parent = {joint.child: joint.parent for joint in model.joints}
    link = model.parts[0].links[0]
    while link in parent:
        link = parent[link]
        owner.setdefault(link, 0)
    for joint in model.joints:
        owner.setdefault(joint.child, owner[joint.parent])
    return owner


def rows_of_parts(model: ArticulatedObject) -> list[list[int]]:
    """Of each part, which of the model's links are of it, or reached from it."""
    owner = parts_of_links(model)
    return [[row for row, link in enumerate(model.links) if owner[link] == node] for node in range(len(model.parts))]
