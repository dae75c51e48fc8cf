"""Where might the object be at all? Whole-object hypotheses, proposed, extended along the joints and thinned out.

Belief propagation refines what it is near to; a closed cabinet looks much the same from its front, its back and half
a width further. Each iteration of the search proposes many root poses (matches of oriented surface points or draws
from the prior, small moves and quarter turns of what did well), walks from the root outwards and gives every joint the
best of several positions for the part behind it, renders the best of the distinct hypotheses whole, and keeps the best
of these as islands. The belief it leaves is made of whole objects: particle i of all parts is one hypothesis.

A search may settle in a wrong place all the same. Where much is left that may be the object, it is looked for there,
too, and all places are compared; where the scan confirms too little of what was found, the search is made again from
the start. The best result stays.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import log_weights as lw
from pmpnbp.inference.belief import FLIP, OWN, Belief, IterationReport, Origin, State
from pmpnbp.inference.chain_growth import grow
from pmpnbp.inference.confirmation import confirmation
from pmpnbp.inference.hypotheses import Hypotheses, Proposals, distinct, part_unary, ranked, walk
from pmpnbp.inference.initialisation import fresh_roots, random_joints
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.rivals import turned, turning_axes
from pmpnbp.inference.settling import SETTLE_INFORMED, SETTLE_UNINFORMED, Settling, settled, tight_tolerance
from pmpnbp.inference.tree_estimate import configuration_scores, polish, profile_scores
from pmpnbp.inference.unexplained import is_within_region, unexplained
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.settings import Schedule

# Of the proposals the share that descends from islands: this much, and this much more over the search, up to so much.
OFFSPRING, MORE_OFFSPRING, MOST_OFFSPRING = 0.3, 0.6, 0.9
# Of the others the share whose joints stay as they are up to the part that was laid on the scan, unless a narrow prior
# says where the root is.
HELD = 0.5
# Standard deviations of an offspring's move, in those of the diffusion: drawn evenly in the logarithm.
SHORTEST_MOVE, LONGEST_MOVE = 0.1, 1.5
# Without a prior, the share of offspring that is given quarter turns; of these, the share turned about the middle of
# any part (that of the largest keeps its outline, that of a small one finds others) and not the root's.
TURNED, TURNED_ABOUT_ANY = 0.3, 0.5
# Hypotheses that are compared to tell distinct ones, and distinct ones that are rendered whole, for each island kept:
# the sum over parts counts a pixel once for every part that claims it, so it may rank the best one low.
COMPARED, RENDERED = 10, 4
# Islands that the first iteration leaves, in those of the last.
FIRST_ISLANDS = 3
# Parts of those of them that are moved to better places, the best first.
REGISTERED = 400
# With a narrow prior this share of them, as fewer places compete.
NARROW_ISLANDS = 0.25
# Hypotheses nearer than this many diffusion lengths are one.
DISTINCT = 1.5
# Places that are found in what the best one left unexplained, for so many rounds polished on all of the scan.
ELSEWHERE, ELSEWHERE_ROUNDS = 4, 4
# Effective share of the islands' weights where the settings leave weights untempered.
EFFECTIVE_SHARE = 0.15


def step(rng: np.random.Generator, state: State, problem: Problem) -> tuple[State, IterationReport]:
    """One iteration of the search; the last one includes further searches where the first did not do."""
    began = time.perf_counter()
    state, report = _searched(rng, state, problem)
    if state.iteration - state.search_after < problem.search_iterations:
        return state, report
    state, report, notes = _looked_elsewhere(rng, state, problem, report)
    shares, rivals = [_explained(problem, state)], [state.rivals]
    while shares[-1] < problem.settings.search_explained and len(shares) <= problem.settings.search_restarts:
        other, its_report = _made_again(rng, state, problem)
        rivals.append(other.rivals)
        if its_report.map_score > report.map_score:
            state, report = other, its_report
        shares.append(_explained(problem, state))
    if len(shares) > 1:
        notes += (
            f"the search was made {len(shares)} times, as the scan confirmed {100 * shares[0]:.0f} % of what the first "
            f"had found; it confirms {100 * shares[-1]:.0f} % of the best",
        )
        state = replace(state, rivals=np.concatenate([some for some in rivals if some is not None]))
    return state, replace(report, rivals=state.rivals, notes=notes, seconds=time.perf_counter() - began)


def _looked_elsewhere(
    rng: np.random.Generator, state: State, problem: Problem, report: IterationReport
) -> tuple[State, IterationReport, tuple[str, ...]]:
    """The search's last iteration, and with it what is found when it is made again in all that its best place leaves
    unexplained, where that is much: the better of both, the other among its rivals; and what is to be said of it.

    Chains are looked for in all of the scan, in the other way, as they begin where their root is seen. Of two places
    one of which is largely outside the region, the other is the better one where the scan confirms it.
    """
    assert state.root is not None and state.joints is not None and state.rivals is not None
    most = problem.settings.search_unexplained
    if not most or not isinstance(problem.prior, UniformPrior):
        return state, report, ()
    rest = unexplained(problem, state.root, state.joints)
    if rest.left <= most:
        return state, report, ()
    found, its_report = _made_again(rng, state, rest.problem if problem.the_other_way is problem else problem)
    assert found.rivals is not None
    plan, before = problem.schedule(problem.search_iterations), found.rivals[:ELSEWHERE]
    places = before[:, :7], before[:, 7:]
    roots, joints, _ = polish(rng, problem, *places, plan, problem.tolerance_end, ELSEWHERE_ROUNDS)
    score = profile_scores(problem, roots, joints)
    rivals = np.concatenate([state.rivals, np.concatenate([roots, joints], axis=1)])
    best = int(score.argmax())
    better = score[best] > report.map_score
    if rest.outside and not better:
        better = is_within_region(problem, roots[best], joints[best])
    if better:
        state = replace(found, root=roots[best], joints=joints[best])
        part_poses = problem.mrf.part_poses(roots[best], joints[best])
        report = replace(its_report, map_poses=part_poses, map_joints=joints[best], map_score=float(score[best]))
    much = f"{100 * rest.left:.0f} % as much as" if rest.left < 1 else "more than"
    note = f"{much} the best place explains was left; the object was looked for there, too"
    return replace(state, rivals=rivals), report, (note,)


def _made_again(rng: np.random.Generator, state: State, problem: Problem) -> tuple[State, IterationReport]:
    """Another search, from the start, that ends in the same iteration."""
    ended, problem = state.iteration, replace(problem.the_other_way, patient=True)
    for number in range(problem.search_iterations):
        before = replace(state, iteration=state.search_after + number)
        state, report = _searched(rng, before, problem, anew=True)
    return replace(state, iteration=ended), replace(report, iteration=ended)


def _explained(problem: Problem, state: State) -> float:
    """The share that the scan confirms of what should be seen where the search has ended."""
    assert state.root is not None and state.joints is not None
    return confirmation(problem, state.root, state.joints, tight_tolerance(problem)).explained


def _searched(
    rng: np.random.Generator, state: State, problem: Problem, *, anew: bool = False
) -> tuple[State, IterationReport]:
    """One iteration of a search. The first one takes nothing from the state before, where it is the inference's first
    search, or `anew`; one that begins again takes the hypotheses that it begins with for islands."""
    number = state.iteration + 1 - state.search_after
    plan = problem.schedule(number)
    nothing = number == 1 and (anew or state.search_after == 0)
    parents = None if nothing else np.unique(state.belief.origin.island[0], return_index=True)[1]
    proposals, kept = _proposals(rng, state, problem, plan, number, parents)
    effort = SETTLE_INFORMED if problem.narrow else SETTLE_UNINFORMED
    last = number == problem.search_iterations
    return compared(
        rng, state, problem, proposals, kept, plan, _islands(problem, number), effort if last else None, "search"
    )


def compared(
    rng: np.random.Generator,
    state: State,
    problem: Problem,
    proposals: Proposals,
    kept: slice,
    plan: Schedule,
    islands: int,
    effort: Settling | None,
    stage: str,
) -> tuple[State, IterationReport]:
    """An iteration that leaves the best of the proposals: extended along the joints, told apart, rendered whole.

    kept : which of the proposals stay as they are; islands : hypotheses that are left, at most
    effort : how these are settled; None before the last word
    """
    began = time.perf_counter()
    if problem.grows:
        tried, total = grow(rng, problem, proposals, plan)
    else:
        tried = walk(rng, problem, proposals, plan, kept, COMPARED * islands)
        total = problem.plus_prior(tried.unary.sum(axis=1), tried.part_poses[:, problem.prior_node])
    order = ranked(total, tried.ancestor, COMPARED * islands)
    leaders, member_of = distinct(problem, tried, order, RENDERED * islands, DISTINCT * plan.diffusion_position)
    whole = configuration_scores(problem, tried.roots[leaders], tried.joints[leaders], plan.tolerance)
    best_first = np.argsort(-whole, kind="stable")[:islands]
    rivals = None
    if effort is None:
        first = best_first[: max(REGISTERED // problem.mrf.nodes, 1)]
        tried, whole[first] = _registered(rng, problem, tried, leaders[first], whole[first], plan)
        total = problem.plus_prior(tried.unary.sum(axis=1), tried.part_poses[:, problem.prior_node])
        best_first = best_first[np.argsort(-whole[best_first], kind="stable")]
    else:
        tried, total = settled(rng, problem, tried.taken(leaders[best_first]), plan, effort)
        order = leaders = member_of = np.arange(len(total))
        whole, best_first = total, np.argsort(-total, kind="stable")
        rivals = np.concatenate([tried.roots, tried.joints], axis=1)[best_first]
    belief, inverse_temperature = _belief(problem, tried, total, order, member_of, leaders, whole, best_first)
    best = leaders[best_first[0]]
    new = State(
        iteration=state.iteration + 1,
        belief=belief,
        root=tried.roots[best],
        joints=tried.joints[best],
        rivals=rivals,
        search_after=state.search_after,
    )
    report = IterationReport.of(
        new,
        stage,
        inverse_temperature=inverse_temperature,
        tolerance=plan.tolerance,
        map_poses=tried.part_poses[best],
        map_score=float(whole[best_first[0]]),
        seconds=time.perf_counter() - began,
    )
    return new, report


def _registered(
    rng: np.random.Generator, problem: Problem, tried: Hypotheses, rows: NDArray[np.int64], score: Array, plan: Schedule
) -> tuple[Hypotheses, Array]:
    """Those tried, of which those at `rows`, with whole-object scores `score` (R,), are one step of registration
    further, and the scores of these then: a few centimetres off, a right place is worth less than many a wrong one in
    the next iteration, which is stricter, and its offspring, moved at random, seldom come nearer in all of its
    coordinates."""
    roots, joints, part_poses, unary = (
        each.copy() for each in (tried.roots, tried.joints, tried.part_poses, tried.unary)
    )
    roots[rows], joints[rows], score = polish(
        rng, problem, roots[rows], joints[rows], plan, plan.tolerance, rounds=1, draws=False, score=score
    )
    part_poses[rows] = problem.mrf.part_poses(roots[rows], joints[rows])
    unary[rows] = part_unary(problem, part_poses[rows], plan.tolerance)
    return replace(tried, roots=roots, joints=joints, part_poses=part_poses, unary=unary), score


def _islands(problem: Problem, number: int) -> int:
    """Islands that iteration `number` of the search leaves: those of the setting in the end, with a narrow prior
    NARROW_ISLANDS of these; FIRST_ISLANDS times as many at first, as early scores say little, and fewer by and by."""
    left = (problem.search_iterations - number) / max(problem.search_iterations - 1, 1)
    share = NARROW_ISLANDS if problem.narrow else 1.0
    return max(round(problem.settings.search_islands * share * (1 + (FIRST_ISLANDS - 1) * left)), 1)


def _proposals(
    rng: np.random.Generator,
    state: State,
    problem: Problem,
    plan: Schedule,
    number: int,
    parents: NDArray[np.int64] | None,
) -> tuple[Proposals, slice]:
    """Roots, joints, source and ancestor: new ones, and offspring of the islands, whose best particles are `parents`
    (most of them later on); and which of them are the islands themselves."""
    count = problem.search_proposals
    share = min(MOST_OFFSPRING, OFFSPRING + MORE_OFFSPRING * number / problem.search_iterations)
    offspring = 0 if parents is None else round(count * share)
    fresh = count - offspring
    if parents is not None:  # of few proposals half at least are other than the islands themselves
        parents = parents[: max(offspring // 2, 1)]
    joints = random_joints(rng, problem, fresh)
    roots, source, matched = fresh_roots(rng, problem, joints)
    held = np.where(rng.random(fresh) < (0.0 if problem.narrow else HELD), matched, 0)
    new = Proposals(roots=roots, joints=joints, source=source, ancestor=np.full(fresh, -1, dtype=np.int32), held=held)
    if parents is None:
        return new, slice(0)
    return new.joined(_offspring(rng, state, problem, plan, parents, offspring)), slice(fresh, fresh + len(parents))


def _offspring(
    rng: np.random.Generator, state: State, problem: Problem, plan: Schedule, parents: NDArray[np.int64], count: int
) -> Proposals:
    """`count` proposals from the islands, whose best particles are `parents`: these as they are, then moved ones."""
    assert state.belief.joint_positions is not None
    ranks = rng.integers(len(parents), size=count)
    # every other child descends from the better half
    ranks[::2] = ranks[::2] // 2
    chosen = parents[ranks]
    chosen[: len(parents)] = parents
    scale = np.exp(rng.uniform(np.log(SHORTEST_MOVE), np.log(LONGEST_MOVE), (count, 1)))
    scale[: len(parents)] = 0.0  # the islands themselves stay in the race
    noise = scale * rng.standard_normal((count, 6))
    shift, turn = plan.diffusion_position * noise[:, :3], plan.diffusion_rotation * noise[:, 3:]
    children = poses.perturb(state.belief.poses[0, chosen], shift, turn, problem.mrf.centres[0])
    source = np.full(count, OWN, dtype=np.uint8)
    if isinstance(problem.prior, UniformPrior):
        flipped = np.flatnonzero(rng.random(count) < TURNED)
        flipped = flipped[flipped >= len(parents)]
        about = rng.integers(problem.mrf.nodes, size=len(flipped)) * (rng.random(len(flipped)) < TURNED_ABOUT_ANY)
        centre = poses.transform_points(state.belief.poses[about, chosen[flipped]], problem.mrf.centres[about])
        quarters = rng.integers(1, 4, size=(len(flipped), 1))
        axes = np.stack(turning_axes(problem, children[flipped]))
        axis = axes[rng.integers(len(axes), size=len(flipped)), np.arange(len(flipped))]
        children[flipped] = turned(children[flipped], centre, axis, quarters)
        source[flipped] = FLIP
    joints, ancestor = state.belief.joint_positions[chosen], chosen.astype(np.int32)
    held = np.zeros(count, dtype=np.int64)
    return Proposals(roots=children, joints=joints, source=source, ancestor=ancestor, held=held)


def _belief(
    problem: Problem,
    tried: Hypotheses,
    total: Array,
    order: NDArray[np.int64],
    member_of: NDArray[np.int64],
    leaders: NDArray[np.int64],
    whole: Array,
    ranked: NDArray[np.int64],
) -> tuple[Belief, float]:
    """Particles: each island gets some in proportion to its tempered weight, at least one, and fills them with its best
    members."""
    count = problem.particles
    share = problem.settings.effective_share or EFFECTIVE_SHARE
    inverse_temperature = float(lw.tempering(whole[ranked], share))
    weights = np.exp(lw.normalise(inverse_temperature * whole[ranked]))
    ranked = ranked[:count]
    slots = 1 + np.floor(weights[: len(ranked)] * (count - len(ranked))).astype(int)
    slots[0] += count - slots.sum()
    rows, island = [], []
    for place, leader in enumerate(ranked):
        members = order[member_of == leader]
        members = np.concatenate([[leaders[leader]], members[members != leaders[leader]]])
        rows.append(members[np.arange(slots[place]) % len(members)])
        island.append(np.full(slots[place], place))
    chosen, where = np.concatenate(rows), np.concatenate(island).astype(np.int32)
    members = tried.taken(chosen)
    # within an island by its members' own scores, between islands by the whole-object ones
    merit = inverse_temperature * (total[chosen] - total[leaders[ranked]][where])
    log_weights = lw.normalise(np.log(weights[where] / slots[where] + 1e-300) + np.minimum(merit, 0.0))
    shape = problem.mrf.nodes, count
    belief = Belief(
        poses=np.ascontiguousarray(np.swapaxes(members.part_poses, 0, 1)),
        log_weights=np.tile(log_weights, (shape[0], 1)),
        log_unary=np.ascontiguousarray(members.unary.T),
        origin=Origin.of(shape, members.source, ancestor=members.ancestor, island=where),
        joint_positions=members.joints,
    )
    return belief, inverse_temperature
