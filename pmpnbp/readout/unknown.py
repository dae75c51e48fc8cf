"""What does the scan not tell at all? Joints that may stand almost anywhere, and parts that may be turned as they like,
or in a few ways that look the same.

A round plate looks the same however it is turned, and a round foot takes the first joint's angle with it: no look from
anywhere would tell. Neither would one tell which of a chair's five feet is the first, or how often a wrist has been
turned round whose limits let it turn further. A drawer that cannot be seen may stand where it likes, until somebody
looks from elsewhere.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.joint_draws import short_way_round
from pmpnbp.inference.mrf import part_motions
from pmpnbp.inference.problem import Problem
from pmpnbp.readout.posterior import TURNED_AT_LEAST, Posterior, Spread
from pmpnbp.scene.articulated_object import ArticulatedObject

# A joint may stand anywhere where its central interval has this share of its range; a turn is any where the mean of
# its draws, as points on the unit circle, is nearer to the middle than this.
ANYWHERE, EVEN = 0.75, 0.3
# It stands in one of some places where its standard deviation within each is less than this share of its range.
IN_PLACE = 0.05
# Metres, and radians beyond a limit, that are rounding.
NO_MOTION = 1e-6


def unknown(problem: Problem, posterior: Posterior, told: Spread) -> tuple[str, ...]:
    """A sentence for each joint coordinate, and for each part that is round or has turns that look the same, of which
    that is all that is known."""
    model = problem.mrf.model
    found, spans = [], _spans(model)
    for coordinate, name in enumerate(model.coordinate_names):
        turns, (low, high) = problem.joint_turns[coordinate], told.joint_intervals[:, coordinate]
        span = spans[coordinate]
        if not 0 < span < np.inf:
            continue
        anywhere = high - low > ANYWHERE * span
        places = []
        if anywhere or told.alike.any():
            places = _places(posterior, coordinate, model.wraps[coordinate], IN_PLACE * span)
        whole = turns and not anywhere and not model.wraps[coordinate]
        whole = whole and _may_be_whole_turns_off(problem, posterior, coordinate)
        if places:
            also = ", and whole turns from there" if whole else ""
            found.append(f"joint '{name}' may be at {' or '.join(_position(one, turns, span) for one in places)}{also}")
        elif anywhere:
            ends = f"{_position(low, turns, span)} to {_position(high, turns, span)}"
            found.append(f"joint '{name}' may be anywhere from {ends}")
        elif whole:
            place = _position((low + high) / 2, turns, span)
            found.append(f"joint '{name}' may be whole turns from {place}, which look the same")
    for part, evenness in zip(model.parts, told.round_turns, strict=True):
        if evenness < EVEN:
            found.append(f"'{part.name}' is round, and may be turned by any angle about its axis")
    mode_poses = np.array([mode.link_poses(model) for mode in posterior.modes])
    for part in model.parts:
        link = model.links.index(part.links[0])
        ways = _turns_apart(mode_poses[told.alike[:, link], link])
        if ways:
            found.append(f"'{part.name}' may be turned in {1 + ways} ways that look the same")
    return tuple(found)


def _spans(model: ArticulatedObject) -> Array:
    """(D,) metres or radians that the joint vector may go over, as the model has it: a prior may leave less of it."""
    spans = model.upper - model.lower
    for joint in model.joints:
        if joint.mimic is None:
            own, entries = np.ptp(joint.limits(), axis=0), list(joint.coordinates)
            spans[entries] = np.where(np.isfinite(own), own, spans[entries])
    return spans


def _may_be_whole_turns_off(problem: Problem, posterior: Posterior, coordinate: int) -> bool:
    """Whether a joint coordinate's limits allow a turn more or less, by which nothing is moved."""
    # where they do, what follows it by another share may be moved
    mrf, model = problem.mrf, problem.mrf.model
    joints = np.tile(posterior.joints, (3, 1))
    joints[1:, coordinate] += 2 * np.pi, -2 * np.pi
    within = np.all((joints >= model.lower - NO_MOTION) & (joints <= model.upper + NO_MOTION), axis=1)
    if not within[1:].any():
        return False
    places = mrf.part_poses(np.tile(posterior.root, (3, 1)), joints)
    moved = part_motions(mrf, places[0], places).max(axis=1)
    return bool(np.any(within[1:] & (moved[1:] < NO_MOTION)))


def _turns_apart(there: Array) -> int:
    """How many of some poses (M, 7) are turned apart."""
    apart: list[Array] = []
    for pose in there:
        if all(poses.rotation_angle(pose[3:], other[3:]) > TURNED_AT_LEAST for other in apart):
            apart.append(pose)
    return len(apart)


def _places(posterior: Posterior, coordinate: int, wraps: NDArray[np.bool_], most: float) -> list[float]:
    """Where the modes that count have a joint coordinate, those within `most` of each other once; none where
    the draws of one are farther from it than that, or there is one place only."""
    found: list[float] = []
    weights = np.exp(posterior.log_weights)
    for number, mode in enumerate(posterior.modes):
        if not mode.counts:
            continue
        place, own = float(mode.joints[coordinate]), posterior.mode == number
        gaps = short_way_round(posterior.drawn_joints[own, coordinate] - place, wraps)
        if not own.any() or weights[own] @ gaps**2 > most**2 * weights[own].sum():
            return []
        if not any(abs(short_way_round(np.array(place - other), wraps)) < most for other in found):
            found.append(place)
    return sorted(found) if len(found) > 1 else []


def _position(value: float, turns: bool, span: float) -> str:
    """In whole degrees or centimetres, or as many digits more as tell places in a range `span` apart."""
    each, unit = (np.degrees(1.0), "°") if turns else (100.0, " cm")
    digits = max(int(np.ceil(-np.log10(span * each))) + 1, 0)
    rounded = round(float(value * each), digits) + 0.0  # no minus zero
    return f"{rounded:.{digits}f}{unit}"
