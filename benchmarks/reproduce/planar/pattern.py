"""The articulated figure: a circle with four arms of two rectangles each, hinged to one another in the plane.

Isard 2003 (PAMPAS) and Desingh et al. 2018 look for this figure in clutter. It is a tree of nine nodes: node 0 is the
circle, nodes 1 to 4 are the inner rectangles, hinged on the circle's rim a quarter turn apart, and nodes 5 to 8 are
the outer ones, hinged at the inner ones' ends. Theirs also have unknown sizes; here sizes are known and every node's
state is a pose. The four arms look alike. What tells them apart is that the figure stands upright within `UPRIGHT`.

A pose is `x y theta`, pixels and radians: the node's centre in the picture, x to the right and y down, and the turn
that takes the x axis towards the y axis. Functions broadcast over leading axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import Array

RADIUS = 16.0  # pixels, of the circle
LENGTH, WIDTH = 40.0, 12.0  # pixels, of every rectangle
CIRCLE, RECTANGLE = 0, 1
UPRIGHT = np.pi / 6  # radians either way, the turn of the circle
INNER_LIMIT, OUTER_LIMIT = np.pi / 6, np.pi / 3  # radians either way, of a rectangle against its parent
REACH = RADIUS + 2 * LENGTH  # pixels, from the circle's centre to the farthest end of an arm


@dataclass(frozen=True)
class Hinge:
    """`child` turns about a point that both nodes hold; points are in pixels in the frame of the node."""

    parent: int
    child: int
    point_parent: tuple[float, float]
    point_child: tuple[float, float]
    rest: float  # radians, the child's turn in the parent's frame in the middle of its range
    limit: float  # radians either way; π or more is a free joint


@dataclass(frozen=True)
class Pattern:
    """A tree of shapes. Message 2 k goes from parent to child of hinge k, message 2 k + 1 back."""

    shape: tuple[int, ...]  # CIRCLE or RECTANGLE of every node
    hinges: tuple[Hinge, ...]

    @property
    def nodes(self) -> int:
        """How many nodes there are."""
        return len(self.shape)

    @property
    def messages(self) -> int:
        """How many directed edges there are."""
        return 2 * len(self.hinges)

    @cached_property
    def sender(self) -> NDArray[np.int64]:
        """(E,) the node that a message comes from."""
        return np.array([node for hinge in self.hinges for node in (hinge.parent, hinge.child)], dtype=np.int64)

    @cached_property
    def receiver(self) -> NDArray[np.int64]:
        """(E,) the node that a message goes to."""
        return np.array([node for hinge in self.hinges for node in (hinge.child, hinge.parent)], dtype=np.int64)

    @cached_property
    def incoming(self) -> tuple[tuple[int, ...], ...]:
        """The messages that each node receives."""
        return tuple(
            tuple(message for message in range(self.messages) if self.receiver[message] == node)
            for node in range(self.nodes)
        )

    @cached_property
    def feeding(self) -> tuple[tuple[int, ...], ...]:
        """For each message t → s the messages u → t, u other than s: ρ(t) ∖ s of eq. 4."""
        return tuple(
            tuple(other for other in self.incoming[self.sender[message]] if other != message ^ 1)
            for message in range(self.messages)
        )


def four_arms() -> Pattern:
    """The figure of Isard 2003 and Desingh et al. 2018."""
    hinges: list[Hinge] = []
    for arm in range(4):
        turn = arm * np.pi / 2
        rim = (RADIUS * float(np.cos(turn)), RADIUS * float(np.sin(turn)))
        hinges.append(Hinge(0, 1 + arm, rim, (-LENGTH / 2, 0.0), turn, INNER_LIMIT))
        hinges.append(Hinge(1 + arm, 5 + arm, (LENGTH / 2, 0.0), (-LENGTH / 2, 0.0), 0.0, OUTER_LIMIT))
    return Pattern((CIRCLE,) + 8 * (RECTANGLE,), tuple(hinges))


def wrap(angle: Array) -> Array:
    """`angle` (...,) in radians, less whole turns, in -π..π."""
    return angle - 2 * np.pi * np.round(angle / (2 * np.pi))


def hinge_frame(pattern: Pattern, message: int, poses: Array, at_sender: bool) -> Array:
    """Where `poses` (..., 3) of one end of `message` put the hinge: (..., 3) its point in the picture, and the turn in
    which parent and child would have the same value in the middle of the range."""
    hinge = pattern.hinges[message // 2]
    of_parent = at_sender == (message % 2 == 0)
    x, y = hinge.point_parent if of_parent else hinge.point_child
    theta = poses[..., 2]
    cosine, sine = np.cos(theta), np.sin(theta)
    turned = theta + hinge.rest if of_parent else theta
    return np.stack([poses[..., 0] + cosine * x - sine * y, poses[..., 1] + sine * x + cosine * y, turned], axis=-1)


def log_pairwise(
    pattern: Pattern, message: int, sender: Array, receiver: Array, sigma_position: float, sigma_angle: float
) -> Array:
    """log ψ(X_t, X_s) (...,) of poses (..., 3) of a message's sender and receiver: a Gaussian of the distance between
    the two places of the hinge, in pixels, and of what the turn is beyond the limits, in radians; 0 at its top."""
    ours = hinge_frame(pattern, message, sender, at_sender=True)
    theirs = hinge_frame(pattern, message, receiver, at_sender=False)
    squared = np.sum((ours[..., :2] - theirs[..., :2]) ** 2, axis=-1)
    beyond = np.maximum(np.abs(wrap(ours[..., 2] - theirs[..., 2])) - pattern.hinges[message // 2].limit, 0.0)
    return -0.5 * (squared / sigma_position**2 + (beyond / sigma_angle) ** 2)


def across(
    rng: np.random.Generator,
    pattern: Pattern,
    message: int,
    poses: Array,
    to_sender: bool,
    sigma_position: float,
    sigma_angle: float,
) -> Array:
    """Draws of X_t given X_s = `poses` (K, 3) of the receiver, or of X_s given X_t where `to_sender` is false, from
    ψ(X_t, X_s) as a density of the one that is drawn (box 1, step 2a; the propagation step of Sudderth et al. 2003)."""
    hinge = pattern.hinges[message // 2]
    count = len(poses)
    known = hinge_frame(pattern, message, poses, at_sender=not to_sender)
    place = known[:, :2] + sigma_position * rng.standard_normal((count, 2))
    # ψ over the turn is flat within the limits with half a Gaussian at either end
    flat = 2 * min(hinge.limit, np.pi)
    tails = np.sqrt(2 * np.pi) * sigma_angle if hinge.limit < np.pi else 0.0
    turn = flat * (rng.random(count) - 0.5)
    tail = sigma_angle * rng.standard_normal(count)
    in_tail = rng.random(count) * (flat + tails) < tails
    theta = known[:, 2] + np.where(in_tail, tail + np.copysign(flat / 2, tail), turn)

    of_parent = to_sender == (message % 2 == 0)
    x, y = hinge.point_parent if of_parent else hinge.point_child
    if of_parent:
        theta = theta - hinge.rest
    cosine, sine = np.cos(theta), np.sin(theta)
    return np.stack([place[:, 0] - cosine * x + sine * y, place[:, 1] - sine * x - cosine * y, wrap(theta)], axis=-1)


def configuration(rng: np.random.Generator, pattern: Pattern, size: int) -> Array:
    """Poses (N, 3) of a figure that hangs together and lies within a picture of `size` by `size` pixels: node 0
    upright, every hinge uniform within its limits."""
    poses = np.zeros((pattern.nodes, 3))
    poses[0, :2] = rng.uniform(REACH, size - REACH, 2)
    poses[0, 2] = rng.uniform(-UPRIGHT, UPRIGHT)
    for number, hinge in enumerate(pattern.hinges):
        frame = hinge_frame(pattern, 2 * number, poses[hinge.parent], at_sender=True)
        theta = float(wrap(frame[2] + rng.uniform(-hinge.limit, hinge.limit)))
        x, y = hinge.point_child
        cosine, sine = np.cos(theta), np.sin(theta)
        poses[hinge.child] = frame[0] - cosine * x + sine * y, frame[1] - sine * x - cosine * y, theta
    return poses


def outlines(pattern: Pattern, poses: Array) -> list[Array]:
    """The closed line (K, 2) around each node's shape at `poses` (N, 3), pixels."""
    turns = np.linspace(0.0, 2 * np.pi, 40)
    around = {
        CIRCLE: RADIUS * np.stack([np.cos(turns), np.sin(turns)], axis=-1),
        RECTANGLE: np.array([[1, 1], [1, -1], [-1, -1], [-1, 1], [1, 1]]) * (LENGTH / 2, WIDTH / 2),
    }
    found = []
    for shape, (x, y, theta) in zip(pattern.shape, poses, strict=True):
        cosine, sine = np.cos(theta), np.sin(theta)
        found.append(around[shape] @ np.array([[cosine, sine], [-sine, cosine]]) + (x, y))
    return found
