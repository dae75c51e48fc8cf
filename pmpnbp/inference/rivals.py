"""What might a hypothesis be mistaken for? Other places of the whole object that look much the same in a depth image.

A cabinet shows the same box from its front, its back and its sides; a laptop that stands like a tent shows the same two
plates when base and lid change places. From one to the other no small move leads, so they are proposed outright: turned
by quarters about the root part's middle or the object's, as it is or shut, and with one part laid where another of
about its size was.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import FLIP
from pmpnbp.inference.hypotheses import Hypotheses, Proposals, walk
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import configuration_scores
from pmpnbp.potentials.unary import render
from pmpnbp.settings import Schedule

# Places near each that are tried, as a front is not where the back was; how far they are turned, in the diffusion's
# deviations.
PLACES, ROTATION = 24, 0.5
# Two parts are of about one size where each of their three extents, the longest first, is within this factor; or both
# are thinner than this share of their largest.
LIKE, THIN = 1.35, 0.15
# Pairs of such parts, drawn at random where there are more: to lay one where the other was, and to shift it there.
PAIRS, SHIFTED_PAIRS = 6, 2


def look_alikes(
    rng: np.random.Generator, problem: Problem, finalists: Hypotheses, plan: Schedule, most: int
) -> Hypotheses:
    """At most `most` hypotheses that look like one of the finalists, those with the best whole-object scores."""
    middles = poses.transform_points(finalists.part_poses, problem.mrf.centres)
    turns = _quarter_turns(problem, finalists, middles[:, 0])
    rest, at_rest = _at_rest(problem, finalists, turns)
    others = [_quarter_turns(problem, finalists, middles.mean(axis=1)), *_exchanged(rng, problem, finalists)]
    places = np.concatenate([at_rest, turns, *others])
    parent = np.arange(len(places)) % len(finalists.roots)
    joints = finalists.joints[parent]
    joints[: len(at_rest)] = rest
    noise = rng.standard_normal((len(places) * PLACES, 6))
    near = poses.perturb(
        np.repeat(places, PLACES, axis=0),
        plan.diffusion_position * noise[:, :3],
        ROTATION * plan.diffusion_rotation * noise[:, 3:],
        problem.mrf.centres[0],
    )
    proposals = Proposals(
        roots=near,
        joints=np.repeat(joints, PLACES, axis=0),
        source=np.full(len(near), FLIP, dtype=np.uint8),
        ancestor=np.repeat(finalists.ancestor[parent], PLACES),
        held=np.zeros(len(near), dtype=np.int64),
    )
    tried = walk(rng, problem, proposals, plan)
    best = tried.unary.sum(axis=1).reshape(-1, PLACES).argmax(axis=1) + np.arange(len(places)) * PLACES
    tried = tried.taken(best)
    score = configuration_scores(problem, tried.roots, tried.joints, plan.tolerance)
    return tried.taken(np.argsort(-score, kind="stable")[:most])


def shifted(rng: np.random.Generator, problem: Problem, finalists: Hypotheses) -> Hypotheses:
    """The finalists moved, not turned, so that the middle of one part is where that of another of about its size was: a
    closed lid in the base's place, the base below the table, explains most of a laptop that is open by a little."""
    pairs = rng.permutation(np.array(like_parts(problem), dtype=np.int64).reshape(-1, 2))[:SHIFTED_PAIRS]
    moved = finalists.taken(np.repeat(np.arange(len(finalists.roots)), len(pairs)))
    one, other = np.tile(pairs, (len(finalists.roots), 1)).T
    each = np.arange(len(one))
    middles = poses.transform_points(moved.part_poses, problem.mrf.centres)
    roots = moved.roots.copy()
    roots[:, :3] += middles[each, other] - middles[each, one]
    return replace(moved, roots=roots, part_poses=problem.mrf.part_poses(roots, moved.joints))


def turned(roots: Array, centre: Array, axis: Array, quarters: NDArray[np.int64] | int) -> Array:
    """Roots (P, 7) turned by `quarters` (P, 1) of 90° about axes (P, 3) through `centre` (P, 3)."""
    turn = poses.from_rotation_vector(np.broadcast_to(quarters, (len(roots), 1)) * (np.pi / 2) * axis)
    position = centre + poses.rotate(turn, roots[:, :3] - centre)
    return np.concatenate([position, poses.quaternion_multiply(turn, roots[:, 3:])], axis=-1)


def turning_axes(problem: Problem, roots: Array) -> list[Array]:
    """Axes (P, 3) that an object may be turned about: up, or where any orientation is possible each of the root's."""
    if problem.any_orientation:
        return [poses.rotate(roots[:, 3:], axis) for axis in np.eye(3)]
    return [np.broadcast_to(problem.observation.up, (len(roots), 3))]


def _quarter_turns(problem: Problem, finalists: Hypotheses, centre: Array) -> Array:
    """Roots (T P, 7): P finalists after each of T turns about points (P, 3)."""
    return np.concatenate(
        [
            turned(finalists.roots, centre, axis, quarters)
            for axis in turning_axes(problem, finalists.roots)
            for quarters in (1, 2, 3)
        ]
    )


def _at_rest(problem: Problem, finalists: Hypotheses, turns: Array) -> tuple[Array, Array]:
    """Joints (D,) at rest, and roots (T P, 7), those of the P finalists after each of T turns, moved to or fro until
    the object with these joints is as far from the cameras as the finalist is, in the median of the pixels that show
    both: a door that was thought open, out of sight behind, is the front when shut, and no front is where the back was.
    """
    mrf, surfaces, count = problem.mrf, problem.surfaces, len(finalists.roots)
    rest: Array = np.clip(0.0, mrf.model.lower, mrf.model.upper)
    roots = turns.copy()
    for view in problem.observation.views:
        before = [render(view.camera, surfaces, parts)[0] for parts in finalists.part_poses]
        away = poses.transform_points(roots, mrf.centres[0]) - view.pose_world_scan[:3]
        if not problem.any_orientation:
            away -= (away @ problem.observation.up)[:, None] * problem.observation.up
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
        for row, parts in enumerate(mrf.part_poses(roots, np.tile(rest, (len(roots), 1)))):
            was, depth = before[row % count], render(view.camera, surfaces, parts)[0]
            both = (was > 0) & (depth > 0)
            if both.any():
                roots[row, :3] += np.median(was[both] - depth[both]) * away[row]
    return rest, roots


def _exchanged(rng: np.random.Generator, problem: Problem, finalists: Hypotheses) -> list[Array]:
    """Roots (P, 7) of the P finalists with one part where another was, in each of the four ways that a box fits one of
    its size; where upright ones only are possible, none."""
    if not problem.any_orientation:
        return []
    pairs = like_parts(problem)
    found = []
    for pick in rng.permutation(len(pairs))[:PAIRS]:
        one, other = pairs[pick]
        for fit in _fits(problem, one, other):
            moved = poses.multiply(finalists.part_poses[:, other], fit)
            found.append(
                poses.multiply(poses.multiply(moved, poses.inverse(finalists.part_poses[:, one])), finalists.roots)
            )
    return found


def like_parts(problem: Problem) -> list[tuple[int, int]]:
    """Ordered pairs of parts of about one size."""
    sizes = np.array([np.sort(problem.mrf.model.parts[node].extents)[::-1] for node in range(problem.mrf.nodes)])
    pairs = []
    for one in range(len(sizes)):
        for other in range(len(sizes)):
            a, b = sizes[one], sizes[other]
            thin = (a < THIN * a[0]) & (b < THIN * b[0])
            if one != other and a[0] > 0 and np.all((np.maximum(a, b) <= LIKE * np.minimum(a, b)) | thin):
                pairs.append((one, other))
    return pairs


def _fits(problem: Problem, one: int, other: int) -> list[Array]:
    """Poses (7,) of part `one` in the frame of `other` that lay its bounding box onto that one, longest side to longest
    side, thinnest to thinnest."""
    a, b = (np.argsort(-problem.mrf.model.parts[node].extents, kind="stable") for node in (one, other))
    found = []
    for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        turn = np.zeros((3, 3))
        turn[b[0], a[0]], turn[b[1], a[1]] = signs
        turn[b[2], a[2]] = 1.0
        turn[b[2], a[2]] = np.sign(np.linalg.det(turn))
        matrix = np.eye(4)
        matrix[:3, :3] = turn
        matrix[:3, 3] = problem.mrf.centres[other] - turn @ problem.mrf.centres[one]
        found.append(poses.from_matrix(matrix))
    return found
