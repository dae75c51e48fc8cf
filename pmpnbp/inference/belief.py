"""Beliefs, messages and reports: the waist of the house. Every algorithm produces them, everything above reads them.

Arrays in here are read-only. Log weights are normalised: their exponentials sum to one over the particles. Poses are
x y z qw qx qy qz, metres, part in world.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float, Int32, UInt8
from numpy.typing import NDArray

from pmpnbp.geometry.poses import Array
from pmpnbp.inference import log_weights as lw

# Where a particle was proposed from (`Origin.source`): the start, its own node's belief, a neighbour's through a joint,
# an oriented point of the scan, a flip of the whole object.
START, OWN, NEIGHBOUR, SURFACE, FLIP = 0, 1, 2, 3, 4
SOURCES = ("start", "own", "neighbour", "surface", "flip")

# Stages of an iteration whose estimate is still on its way.
SEARCH_STAGES = ("start", "search")

Indices = NDArray[np.int32]


@dataclass(frozen=True, kw_only=True)
class Origin:
    """Where each particle comes from.

    source : one of START, OWN, NEIGHBOUR, SURFACE, FLIP
    ancestor : index of the particle in the iteration before it descends from (of node `neighbour` where source is
        NEIGHBOUR); -1 where it has none
    neighbour : the node it was proposed from; -1 where source is not NEIGHBOUR
    island : the hypothesis it belongs to; zeros where the belief is one population
    """

    source: UInt8[NDArray[np.uint8], "parts particles"]
    ancestor: Int32[Indices, "parts particles"]
    neighbour: Int32[Indices, "parts particles"]
    island: Int32[Indices, "parts particles"]

    def __post_init__(self) -> None:
        _freeze(self)

    @classmethod
    def of(
        cls,
        shape: tuple[int, ...],
        source: NDArray[np.uint8] | int,
        *,
        ancestor: NDArray[np.integer] | int = -1,
        neighbour: NDArray[np.integer] | int = -1,
        island: NDArray[np.integer] | int = 0,
    ) -> Origin:
        """Origins of particles in an array of `shape`, from members that broadcast to it."""
        return cls(
            source=np.array(np.broadcast_to(source, shape), dtype=np.uint8),
            ancestor=np.array(np.broadcast_to(ancestor, shape), dtype=np.int32),
            neighbour=np.array(np.broadcast_to(neighbour, shape), dtype=np.int32),
            island=np.array(np.broadcast_to(island, shape), dtype=np.int32),
        )


@dataclass(frozen=True, kw_only=True)
class Belief:
    """Particles of every node.

    log_weights : normalised per node
    log_unary : natural log of the unary potential at each particle, before tempering: the part's, or in the particle
        filter the whole object's in every row
    joint_positions : where particle i of all nodes is one whole-object hypothesis; else None
    """

    poses: Float[Array, "parts particles 7"]
    log_weights: Float[Array, "parts particles"]
    log_unary: Float[Array, "parts particles"]
    origin: Origin
    joint_positions: Float[Array, "particles dof"] | None = None

    def __post_init__(self) -> None:
        _freeze(self)


@dataclass(frozen=True, kw_only=True)
class Messages:
    """Messages m_{t→s} over the directed edges, particles of the receiving node s (algorithm box 1).

    poses : samples of the receiver's pose
    log_weights : normalised
    log_unary, log_neighbour : its two factors w_unary and w_neigh (log_neighbour is the sum over the sender's other
        neighbours)
    joint_draw : axis positions of the joint draw that explains the sender's part best; 0 beyond an edge's own
    """

    sender: Int32[Indices, " messages"]
    receiver: Int32[Indices, " messages"]
    poses: Float[Array, "messages samples 7"]
    log_weights: Float[Array, "messages samples"]
    log_unary: Float[Array, "messages samples"]
    log_neighbour: Float[Array, "messages samples"]
    joint_draw: Float[Array, "messages samples axes"]

    def __post_init__(self) -> None:
        _freeze(self)


@dataclass(frozen=True, kw_only=True)
class State:
    """What the next iteration needs, and nothing else; every part of it is recorded.

    root, joints : the whole-object estimate so far, None before the first; nuisances : (K,) what it takes these for,
        see `potentials/nuisances.py`, or None
    rivals : (R, 7 + D) root pose and joint vector of each place that the search compared last, or None without one
    search_after : the iteration after which the search began, and with it the annealing; 0 unless it began again
    """

    iteration: int
    belief: Belief
    messages: Messages | None = None
    root: Float[Array, " 7"] | None = None
    joints: Float[Array, " dof"] | None = None
    nuisances: Float[Array, " nuisances"] | None = None
    rivals: Float[Array, "rivals configuration"] | None = None
    search_after: int = 0


@dataclass(frozen=True, kw_only=True)
class IterationReport:
    """One iteration as it is recorded: enough to ask "why this weight".

    iteration : 0 is the start; stage : "start", "search", "tracking", "belief propagation", "particle filter",
        "refine"
    belief : the weighted set before resampling, so that every weight can be explained
    messages : what was sent, or None
    log_message_shares : log of each incoming message's share in a particle's weight, NaN beyond a node's own
        neighbours, which are in the order of `Mrf.incoming`
    inverse_temperature : lambda, the factor on each node's log potential; tolerance : tau in metres
    map_poses : the estimate of each part this iteration, the maximum of potential times prior; map_joints : None where
        the parts need not agree with a tree; map_score : whole-object log score
    seconds : wall time of the iteration
    nuisances : (K,) what the estimate takes these for, see `potentials/nuisances.py`, or None
    rivals, search_after : those of the state that the iteration led to
    """

    iteration: int
    stage: str
    belief: Belief
    messages: Messages | None
    log_message_shares: Float[Array, "parts particles neighbours"]
    inverse_temperature: Float[Array, " parts"]
    tolerance: float
    effective_sample_size: Float[Array, " parts"]
    map_poses: Float[Array, "parts 7"]
    map_joints: Float[Array, " dof"] | None
    map_score: float
    seconds: float
    notes: tuple[str, ...] = ()
    nuisances: Float[Array, " nuisances"] | None = None
    rivals: Float[Array, "rivals configuration"] | None = None
    search_after: int = 0

    @property
    def searching(self) -> bool:
        """Whether there is no posterior about the estimate yet."""
        return self.stage in SEARCH_STAGES

    @classmethod
    def of(
        cls,
        state: State,
        stage: str,
        *,
        map_poses: Array,
        map_score: float,
        inverse_temperature: Array | float,
        tolerance: float,
        seconds: float,
        messages: Messages | None = None,
        log_message_shares: Array | None = None,
    ) -> IterationReport:
        """The report of the iteration that led to `state`; without shares, of one that sent no messages."""
        log_weights = state.belief.log_weights
        return cls(
            iteration=state.iteration,
            stage=stage,
            belief=state.belief,
            messages=messages,
            log_message_shares=np.zeros((*log_weights.shape, 0)) if log_message_shares is None else log_message_shares,
            inverse_temperature=np.full(len(log_weights), inverse_temperature),
            tolerance=tolerance,
            effective_sample_size=lw.effective_sample_size(log_weights),
            map_poses=map_poses,
            map_joints=state.joints,
            map_score=map_score,
            seconds=seconds,
            nuisances=state.nuisances,
            rivals=state.rivals,
            search_after=state.search_after,
        )


def _freeze(value: object) -> None:
    for entry in fields(value):  # type: ignore[arg-type]
        array = getattr(value, entry.name)
        if isinstance(array, np.ndarray):
            array.setflags(write=False)
