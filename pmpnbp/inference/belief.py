"""Beliefs, messages and reports: the waist of the house. Every algorithm produces them, everything above reads them.

Arrays in here are read-only. Log weights are normalised: their exponentials sum to one over the particles.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import Array

# Where a particle was proposed from (`Belief.source`): the start, its own node's belief, a neighbour's through a joint,
# an oriented point of the scan, a flip of the whole object.
START, OWN, NEIGHBOUR, SURFACE, FLIP = 0, 1, 2, 3, 4
SOURCES = ("start", "own", "neighbour", "surface", "flip")


@dataclass(frozen=True)
class Belief:
    """Particles of every node.

    poses : (N, T, 7), x y z qw qx qy qz, metres, part in world
    log_weights : (N, T), normalised per node
    log_unary : (N, T), natural log of the unary potential at each particle, before tempering: the part's, or in the
        particle filter the whole object's in every row
    ancestor : (N, T) int32, index of the particle in the iteration before it descends from (of node `neighbour` where
        source is NEIGHBOUR); -1 where it has none
    source : (N, T) uint8, one of START, OWN, NEIGHBOUR, SURFACE, FLIP
    neighbour : (N, T) int32, the node it was proposed from; -1 where source is not NEIGHBOUR
    island : (N, T) int32, the hypothesis it belongs to; zeros where the belief is one population
    joint_positions : (T, D) where particle i of all nodes is one whole-object hypothesis; else None
    """

    poses: Array
    log_weights: Array
    log_unary: Array
    ancestor: NDArray[np.int32]
    source: NDArray[np.uint8]
    neighbour: NDArray[np.int32]
    island: NDArray[np.int32]
    joint_positions: Array | None = None

    def __post_init__(self) -> None:
        _freeze(self)


@dataclass(frozen=True)
class Messages:
    """Messages m_{t→s} over the E directed edges, particles of the receiving node s (algorithm box 1).

    sender, receiver : (E,) int32
    poses : (E, M, 7), samples of the receiver's pose
    log_weights : (E, M), normalised
    log_unary, log_neighbour : (E, M), its two factors w_unary and w_neigh (log_neighbour is the sum over the senders'
        other neighbours)
    joint_draw : (E, M, K) axis positions of the joint draw that explains the sender's part best; 0 beyond an edge's own
    """

    sender: NDArray[np.int32]
    receiver: NDArray[np.int32]
    poses: Array
    log_weights: Array
    log_unary: Array
    log_neighbour: Array
    joint_draw: Array

    def __post_init__(self) -> None:
        _freeze(self)


@dataclass(frozen=True)
class State:
    """What the next iteration needs, and nothing else; every part of it is recorded.

    root, joints : (7,), (D,) the whole-object estimate so far, None before the first
    """

    iteration: int
    belief: Belief
    messages: Messages | None = None
    root: Array | None = None
    joints: Array | None = None


@dataclass(frozen=True)
class IterationReport:
    """One iteration as it is recorded: enough to ask "why this weight".

    iteration : 0 is the start; stage : "start", "search", "belief propagation", "particle filter", "refine"
    belief : the weighted set before resampling, so that every weight can be explained
    messages : what was sent, or None
    log_message_shares : (N, T, K) log of each incoming message's share in a particle's weight, K the largest number
        of neighbours, NaN beyond a node's own; neighbours as `mrf.neighbours` lists them
    temperature : (N,) the factor on the log potential (1 / tempering), tolerance : tau in metres
    effective_sample_size : (N,)
    mle : (N, 7) the best pose of each part this iteration; mle_joints : (D,), None where the parts need not agree
        with a tree; mle_score : whole-object log score
    seconds : wall time of the iteration
    """

    iteration: int
    stage: str
    belief: Belief
    messages: Messages | None
    log_message_shares: Array
    temperature: Array
    tolerance: float
    effective_sample_size: Array
    mle: Array
    mle_joints: Array | None
    mle_score: float
    seconds: float
    notes: tuple[str, ...] = field(default=())


def _freeze(value: object) -> None:
    for entry in fields(value):  # type: ignore[arg-type]
        array = getattr(value, entry.name)
        if isinstance(array, np.ndarray):
            array.setflags(write=False)
