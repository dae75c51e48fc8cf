"""By which part is an object held, when it is moved to see where else it could be? Its coordinates about a place are
the pose of that part, and joint positions; all other parts follow.

An object whose root is seen is held by its root. A screen that hides its own arm and foot is known to a millimetre,
while the foot may stand anywhere behind it. Held by the foot, every joint that moves would carry the screen off, and
what is open would be a curved path of foot and joints together, that no Gaussian follows. Held by the screen, it is
where each joint may be.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.joint_draws import short_way_round
from pmpnbp.inference.mrf import Mrf
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.unary import renders
from pmpnbp.scene.observation import View

# The root holds the object where it confirms this share of the pixels that the best seen part does.
ENOUGH = 0.1
# Metres or radians that a coordinate is moved by for a derivative.
LITTLE = 1e-4


@dataclass(frozen=True, eq=False)
class Held:
    """Coordinates (6 + D,) about a configuration (7,), (D,) of the object, held by one of its parts: the translation of
    that part's centre, metres, and its rotation vector, in the world's axes; joints."""

    mrf: Mrf
    part: int
    root: Array
    joints: Array

    def placed(self, offsets: Array) -> tuple[Array, Array]:
        """Root poses (C, 7) and joint vectors (C, D), which may be beyond their limits, at offsets (C, 6 + D)."""
        joints = self.joints + offsets[:, 6:]
        return self.roots(offsets[:, :6], joints), joints

    def roots(self, moves: Array, joints: Array) -> Array:
        """(C, 7) where the part has moved by (C, 6) and joints are at (C, D)."""
        at = poses.perturb(self._pose, moves[:, :3], moves[:, 3:], self.mrf.centres[self.part])
        return at if self.part == 0 else poses.multiply(at, poses.inverse(self._from_root(joints)))

    def offsets(self, roots: Array, joints: Array) -> Array:
        """(K, 6 + D) of configurations (K, 7), (K, D)."""
        at = roots if self.part == 0 else poses.multiply(roots, self._from_root(joints))
        moves, turns = poses.perturbation(self._pose, at, self.mrf.centres[self.part])
        return np.concatenate([moves, turns, short_way_round(joints - self.joints, self.mrf.model.wraps)], axis=1)

    @cached_property
    def by_root(self) -> Array:
        """(6 + D, 6 + D): how small offsets of the same object held by its root follow these, linearly."""
        size = 6 + len(self.joints)
        held_by_root = Held(self.mrf, 0, self.root, self.joints)
        found: Array = held_by_root.offsets(*self.placed(LITTLE * np.eye(size))).T / LITTLE
        return found

    @cached_property
    def _pose(self) -> Array:
        if self.part == 0:
            return self.root
        found: Array = self.mrf.part_poses(self.root, self.joints)[self.part]
        return found

    def _from_root(self, joints: Array) -> Array:
        """(C, 7) of the part in the root's frame."""
        found: Array = self.mrf.part_poses(poses.IDENTITY, joints)[:, self.part]
        return found


def held(problem: Problem, root: Array, joints: Array) -> Held:
    """A configuration (7,), (D,) held by its root, or by the part that is seen best where of the root hardly any is."""
    seen = np.zeros(problem.mrf.nodes)
    part_poses = problem.mrf.part_poses(root, joints)
    for view, _, depth, number in renders(problem.observation, problem.surfaces, part_poses, problem.nuisances):
        seen += np.bincount(number[shown(problem, view, depth)], minlength=len(seen))
    best = int(seen.argmax())
    return Held(problem.mrf, 0 if seen[0] >= ENOUGH * seen[best] else best, root, joints)


def shown(problem: Problem, view: View, depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(h, w): the pixels of a render (h, w), metres, in which the view measured what is drawn."""
    found: NDArray[np.bool_] = (depth > 0) & (view.depth > 0) & (np.abs(view.depth - depth) < problem.tolerance_end)
    return found
