"""The Markov random field of an articulated object: parts as nodes, joints as edges, two messages an edge."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.tree_table import tree_table
from pmpnbp.potentials.kernels import kinematics
from pmpnbp.potentials.kernels.tree import Tree, place
from pmpnbp.potentials.pairwise import EdgeTable, edge_table
from pmpnbp.scene.articulated_object import ArticulatedObject, Edge

# Metres: the radius of a part without a surface; and the least lever that a turn is reckoned by, so that a tiny part
# does not turn by any angle at a time.
UNSEEN_RADIUS, LEAST_LEVER = 0.05, 0.02


@dataclass(frozen=True, kw_only=True)
class Mrf:
    """Directed edges and the edge table for the kernels.

    sender, receiver, edge : (E,) int32, E = 2 * number of edges; message e goes sender[e] → receiver[e] along the
        object's edge[e]; message 2k is parent → child of edge k, message 2k + 1 child → parent
    incoming : for each node, the messages that reach it, in order of their number
    feeding : (E,) lists: the messages u → sender[e] with u other than receiver[e] (box 1 step 2c)
    table : the edges as the pairwise potential's sums take them
    tree : numbers of the edges that first reach their child; the others close loops
    tree_table : these edges as the kernels over the whole tree take them
    depth : joints between the root and the part farthest from it
    centres, radii : (N, 3), (N,) metres, middle of each part's bounding box and its half diagonal
    """

    model: ArticulatedObject
    sender: NDArray[np.int32]
    receiver: NDArray[np.int32]
    edge: NDArray[np.int32]
    incoming: tuple[tuple[int, ...], ...]
    feeding: tuple[tuple[int, ...], ...]
    tree: tuple[int, ...]
    tree_table: Tree
    depth: int
    centres: Array
    radii: Array
    axis_count: NDArray[np.int64]
    before: Array
    revolute: NDArray[np.bool_]
    axes: Array
    after: Array
    table: EdgeTable

    @property
    def nodes(self) -> int:
        """Number of nodes N."""
        return len(self.model.parts)

    @property
    def axes_per_edge(self) -> int:
        """Largest number K of axes of an edge."""
        return self.before.shape[1]

    def edges_in_a_row(self, count: int) -> list[tuple[Edge, ...]]:
        """All rows of `count` edges of the tree, each but the first from the child of the one before."""
        edges = [self.model.edges[number] for number in self.tree]
        rows: list[tuple[Edge, ...]] = [(edge,) for edge in edges]
        for _ in range(count - 1):
            rows = [(*row, edge) for row in rows for edge in edges if edge.parent == row[-1].child]
        return rows

    def part_poses(self, pose_world_root: Array, joint_positions: Array) -> Array:
        """`ArticulatedObject.part_poses`, compiled: (..., N, 7) from (..., 7) and (..., D), which broadcast."""
        shape = joint_positions.shape[:-1]
        if pose_world_root.shape[:-1] != shape:
            shape = np.broadcast_shapes(pose_world_root.shape[:-1], shape)
            pose_world_root = np.broadcast_to(pose_world_root, (*shape, 7))
            joint_positions = np.broadcast_to(joint_positions, (*shape, self.model.dof))
        count = math.prod(shape)
        # a kernel would be compiled once more for read-only arrays
        roots = np.require(pose_world_root.reshape(count, 7), np.float64, ["C", "W"])
        joints = np.require(joint_positions.reshape(count, self.model.dof), np.float64, ["C", "W"])
        out = np.empty((count, self.nodes, 7))
        place(self.tree_table, roots, joints, out)
        return out.reshape(*shape, self.nodes, 7)

    def across(self, message: NDArray[np.int32], poses_receiver: Array, axis_positions: Array) -> Array:
        """Poses of the sender's part (G, M, D, 7) for poses of the receiver's (G, M, 7) and axis positions
        (G, M, D, K), for the messages (G,)."""
        out = np.empty((*axis_positions.shape[:3], 7))
        # message 2k + 1 is sent by the child, so the way back from its receiver leads to the child
        kinematics.through_joints(
            np.ascontiguousarray(poses_receiver),
            self.edge[message],
            message % 2 == 1,
            np.ascontiguousarray(axis_positions),
            self.axis_count,
            self.before,
            self.revolute,
            self.axes,
            self.after,
            out,
        )
        return out


def part_motions(mrf: Mrf, before: Array, after: Array) -> Array:
    """(..., N) metres that each part's middle moves between part poses (N, 7) and (..., N, 7), and by turning its
    rim."""
    middle = poses.transform_points(after, mrf.centres) - poses.transform_points(before, mrf.centres)
    turned = poses.rotation_angle(after[..., 3:], before[..., 3:])
    found: Array = np.linalg.norm(middle, axis=-1) + mrf.radii * turned
    return found


def build(model: ArticulatedObject) -> Mrf:
    """The MRF of a model. Edges beyond a tree are allowed: the graph may have loops."""
    edges = model.edges
    sender = np.array([[edge.parent, edge.child] for edge in edges], dtype=np.int32).reshape(-1)
    receiver = np.array([[edge.child, edge.parent] for edge in edges], dtype=np.int32).reshape(-1)
    messages = range(len(sender))
    incoming = tuple(tuple(e for e in messages if receiver[e] == node) for node in range(len(model.parts)))
    # the message back along the same edge is e ^ 1; of two edges between the same parts only that one is left out
    feeding = tuple(tuple(f for f in incoming[sender[e]] if f != e ^ 1) for e in messages)
    depth = max((len(edge.axes) for edge in edges), default=1)
    tree = _tree(model)
    count = len(edges)
    before, axes = np.zeros((count, depth, 7)), np.zeros((count, depth, 3))
    revolute, after = np.zeros((count, depth), dtype=bool), np.zeros((count, 7))
    before[..., 3] = 1.0
    for row, edge in enumerate(edges):
        k = len(edge.axes)
        before[row, :k], axes[row, :k], revolute[row, :k] = edge.poses_before, edge.axes, edge.revolute
        after[row] = edge.pose_after
    centres = np.array([part.centre for part in model.parts]).reshape(-1, 3)
    radii = np.array([np.linalg.norm(part.extents) / 2 if part.visible else UNSEEN_RADIUS for part in model.parts])
    return Mrf(
        model=model,
        sender=sender,
        receiver=receiver,
        edge=np.arange(len(sender), dtype=np.int32) // 2,
        incoming=incoming,
        feeding=feeding,
        tree=tree,
        tree_table=tree_table([edges[number] for number in tree], len(model.parts)),
        depth=_depth(model, tree),
        centres=centres,
        radii=radii,
        axis_count=np.array([len(edge.axes) for edge in edges], dtype=np.int64),
        before=before,
        revolute=revolute,
        axes=axes,
        after=after,
        table=edge_table(edges),
    )


def _tree(model: ArticulatedObject) -> tuple[int, ...]:
    reached = {0}
    tree = []
    for number, edge in enumerate(model.edges):
        if edge.child not in reached:
            reached.add(edge.child)
            tree.append(number)
    return tuple(tree)


def _depth(model: ArticulatedObject, tree: tuple[int, ...]) -> int:
    steps = {0: 0}
    for number in tree:
        steps[model.edges[number].child] = steps[model.edges[number].parent] + 1
    return max(steps.values())
