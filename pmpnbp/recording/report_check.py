"""Does an iteration of a recording from elsewhere fit the recording's own model?

Its bytes are as they were written, but who wrote them is not known: the shapes and numbers of its arrays are checked
before anything is drawn or counted from them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmpnbp.errors import RecordingError
from pmpnbp.inference.belief import SOURCES, IterationReport, Messages
from pmpnbp.inference.problem import Problem
from pmpnbp.names import name_fault

# Metres, and radians of a joint; nothing that a sensor sees is further away.
_MOST_DISTANT = 1e4


def check_fits(problem: Problem, report: IterationReport) -> None:
    """RecordingError where arrays of a report have other shapes or kinds than its problem makes, or a pose is none."""
    if not _fits(problem, report):
        raise RecordingError(f"iteration {report.iteration} does not fit the model of its recording")


@np.errstate(all="ignore")  # whatever the numbers are, it is told once
def _fits(problem: Problem, report: IterationReport) -> bool:
    nodes, dof = problem.mrf.nodes, problem.mrf.model.dof
    belief, messages = report.belief, report.messages
    if belief.log_weights.ndim != 2 or belief.log_weights.shape[1] < 1:
        return False
    count = belief.log_weights.shape[1]
    each = nodes, count
    sound = [
        _numbers(belief.poses, (*each, 7)),
        _numbers(belief.log_weights, each) and bool(np.allclose(np.exp(belief.log_weights).sum(axis=1), 1, atol=1e-3)),
        _numbers(belief.log_unary, each),
        *(are_whole(array, each) for array in vars(belief.origin).values()),
        belief.joint_positions is None or are_in_reach(belief.joint_positions, (count, dof)),
        _numbers(report.log_message_shares, (*each, *report.log_message_shares.shape[2:3])),
        are_numbers(report.inverse_temperature, (nodes,)) and are_numbers(report.effective_sample_size, (nodes,)),
        are_poses(report.map_poses, (nodes, 7)),
        report.map_joints is None or are_in_reach(report.map_joints, (dof,)),
        report.nuisances is None or are_small(report.nuisances, problem.nuisance_std.shape),
        report.rivals is None or _rivals(report.rivals, dof),
        0 <= report.search_after <= report.iteration,
        name_fault(report.stage) is None,
        math.isfinite(report.tolerance) and math.isfinite(report.seconds),
    ]
    if not all(sound):
        return False
    if not are_poses(belief.poses, (*each, 7)) or not np.all(belief.origin.source < len(SOURCES)):
        return False
    return bool(np.all(belief.origin.neighbour < nodes)) and (
        messages is None or _messages_fit(problem, report, messages)
    )


def _messages_fit(problem: Problem, report: IterationReport, messages: Messages) -> bool:
    shares = max((len(incoming) for incoming in problem.mrf.incoming), default=0)
    edges, samples = len(problem.mrf.sender), messages.log_weights.shape[-1] if messages.log_weights.ndim else 0
    factors = messages.log_weights, messages.log_unary, messages.log_neighbour
    return (
        np.array_equal(messages.sender, problem.mrf.sender)
        and np.array_equal(messages.receiver, problem.mrf.receiver)
        and all(_numbers(array, (edges, samples)) for array in factors)
        and are_poses(messages.poses, (edges, samples, 7))
        and are_in_reach(messages.joint_draw, (edges, samples, problem.mrf.axes_per_edge))
        and report.log_message_shares.shape[2] == shares
        and _shares_have_samples(report.log_message_shares, samples)
    )


def _shares_have_samples(shares: NDArray[Any], samples: int) -> bool:
    """Whether each share is of a sample that its message has: pooled samples stand message after message."""
    if samples == shares.shape[1]:
        return True
    particle, place = np.nonzero(~np.isnan(shares).all(axis=0))
    return bool(np.all(particle // samples == place))


def _numbers(array: NDArray[Any], shape: tuple[int, ...]) -> bool:
    return array.shape == shape and array.dtype.kind == "f"


def are_whole(array: NDArray[Any], shape: tuple[int, ...]) -> bool:
    """Whether these are whole numbers in this shape."""
    return array.shape == shape and array.dtype.kind in "iu"


def are_numbers(array: NDArray[Any], shape: tuple[int, ...]) -> bool:
    """Whether these are finite numbers in this shape."""
    return _numbers(array, shape) and bool(np.isfinite(array).all())


def are_in_reach(array: NDArray[Any], shape: tuple[int, ...]) -> bool:
    """Whether these are lengths or angles in this shape, none of them beyond all reach."""
    return are_numbers(array, shape) and bool(np.all(np.abs(array) <= _MOST_DISTANT))


def are_small(array: NDArray[Any], shape: tuple[int, ...]) -> bool:
    """Whether these are nuisances under which something can be drawn: scales stay above zero."""
    return are_numbers(array, shape) and bool(np.all(np.abs(array) < 1))


def _rivals(array: NDArray[Any], dof: int) -> bool:
    shape = (len(array), 7 + dof) if array.ndim == 2 else ()
    return are_in_reach(array, shape) and are_poses(array[:, :7], (len(array), 7))


def are_poses(array: NDArray[Any], shape: tuple[int, ...]) -> bool:
    """Whether these are poses, with quaternions of about unit length."""
    return are_in_reach(array, shape) and bool(np.allclose(np.linalg.norm(array[..., 3:], axis=-1), 1, atol=1e-3))
