"""The same object a little wider, deeper or higher: every length of its model stretched along the root part's axes.

What stands there is seldom to the millimetre what its model says. A cabinet that is 2 % wider has wider drawers, and
joints farther apart. The stretch is that of the whole object with all joints at zero; joint positions stay metres and
radians. Surfaces are not stretched here, but where they are drawn (`potentials/nuisances.py`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.articulated_object import ArticulatedObject, Edge, Joint, Part, axis_motion


def axes_at_zero(model: ArticulatedObject) -> Array:
    """(N, 3, 3): of each part, rotation matrix from its frame to the root part's with all joints at zero."""
    found: Array = poses.to_matrix(model.part_poses(poses.IDENTITY, np.zeros(model.dof)))[:, :3, :3]
    return found


def resized(model: ArticulatedObject, sizes: Array) -> ArticulatedObject:
    """A model whose lengths along the x, y and z axes of the root part are `sizes` (..., 3), shares, larger than those
    of the URDF, whatever they are in `model`. With leading dimensions there are as many models in one, whose kinematics
    broadcast against root poses and joint vectors."""
    stretch = (1.0 + sizes) / (1.0 + model.sizes) - 1.0
    zero = np.zeros(model.dof)
    parts = model.part_poses(poses.IDENTITY, zero)
    links = dict(zip(model.links, model.link_poses(parts, zero), strict=True))
    return replace(
        model,
        parts=tuple(_part(part, parts[number], stretch) for number, part in enumerate(model.parts)),
        edges=tuple(_edge(edge, parts[edge.parent], zero, stretch) for edge in model.edges),
        joints=tuple(_joint(joint, links[joint.parent], stretch) for joint in model.joints),
        sizes=sizes,
    )


def _part(part: Part, at: Array, stretch: Array) -> Part:
    return replace(part, poses_part_link=_stretched(part.poses_part_link, at, stretch[..., None, :]))


def _joint(joint: Joint, parent: Array, stretch: Array) -> Joint:
    return replace(joint, pose_parent_joint=_stretched(joint.pose_parent_joint, parent, stretch))


def _edge(edge: Edge, at: Array, zero: Array, stretch: Array) -> Edge:
    moved, before = edge.axis_positions(zero), []
    for k in range(len(edge.axes)):
        before.append(_stretched(edge.poses_before[k], at, stretch))
        at = poses.multiply(at, edge.poses_before[k])
        at = poses.multiply(at, axis_motion(bool(edge.revolute[k]), edge.axes[k], moved[k]))
    return replace(edge, poses_before=np.stack(before, axis=-2), pose_after=_stretched(edge.pose_after, at, stretch))


def _stretched(pose: Array, at: Array, stretch: Array) -> Array:
    """Poses (..., 7) in a frame whose own pose in the root part's is `at` (7,), their positions stretched along the
    root part's axes by shares (..., 3)."""
    along = stretch * poses.rotate(at[3:], pose[..., :3])
    position = pose[..., :3] + poses.rotate(poses.quaternion_conjugate(at[3:]), along)
    return np.concatenate([position, np.broadcast_to(pose[..., 3:], (*position.shape[:-1], 4))], axis=-1)
