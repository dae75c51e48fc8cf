"""How sure can one be of the object, given the scan? Weighted draws of root pose and joint positions about a mode.

The belief's own spread follows its diffusion and is no uncertainty (docs/algorithm.md, "Spread"). Here the whole object
is rendered and scored at every draw (`log_posterior`). Draws stay in the mode that they are asked about, but for joints
whose place the scan does not tell, which go over their whole range. Joints that close a loop are left out. Nuisances
that are not fixed are drawn with the rest, so that a depth scale which the scan does not tell is a spread along the
line of sight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from pmpnbp.geometry.poses import Array
from pmpnbp.inference.held_part import Held, held
from pmpnbp.inference.joint_draws import within_limits
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.nuisances import split
from pmpnbp.readout.chain_bends import bends, bent_otherwise
from pmpnbp.readout.checkpoint import Checkpoint, go_on
from pmpnbp.readout.first_proposal import (
    LOOSE,
    Elsewhere,
    curvature_information,
    joints_elsewhere,
    measured_covariance,
    prior_information,
)
from pmpnbp.readout.free_turn import free_turn, turned_anyhow
from pmpnbp.readout.image_grain import blunted, grain
from pmpnbp.readout.importance_sampling import LogDensity, Proposal, adaptive_importance, standardised
from pmpnbp.readout.log_posterior import log_posterior
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.prior import UniformPrior

# Draws of the first round, whose proposal is a guess; of each further one, at least, and for each coordinate at most,
# else as many as the covariance that is fitted to them has elements; rounds at most; and how many draws have to count,
# times the power that their weights have, before no more are made.
FIRST, LEAST, EACH, ROUNDS, ENOUGH = 96, 64, 16, 48, 20.0
# The power that weights have at the least, for each coordinate, and at the most; and draws at the least, as multiples
# of the elements of their covariance. The more coordinates there are the longer proposals take to settle, and where
# weights have little power the draws are rather as these.
POWER, MOST_POWER, SETTLED = 0.03, 0.5, 4
# Metres and radians: no joint is taken for better known than this where modes are weighed.
SHUT = 1e-4
# Share of its score by which a place may be worth more or less than another for no good reason: on even seeds rivals
# in sight are worse than right estimates by 4 % and more, and those that are taken for each other within 2 %. Of 0.007,
# 0.005 and 0.0035 the second had as many certain parts right as the first, and the third fewer.
MISFIT = 0.005
# Metres from the mode at most: where nothing at all is seen the draws would go on without end.
ASTRAY = 2.0
# How far a parameter that the scan does not hold starts beside nuisances that it does not tell either: it goes as far
# as their prior takes it.
UNTOLD = 1.0


@dataclass(frozen=True, kw_only=True)
class ModeDraws:
    """Draws of one mode of the object.

    roots : (K, 7); joints : (K, D); log_weights : (K,), their exponentials sum to 1
    about : the configuration that was drawn about, and its coordinates
    middle, held_stds : (6 + D,) in these coordinates, before they were stirred: their mean, and the standard deviation
        of each where all others are held: joints of a chain that turn against each other may each be anywhere, and
        tell of one another where
    nuisances : (K, ...), see `potentials/nuisances.py`, and `middle_nuisances` their mean before they were stirred;
        None where all are fixed
    nats : the log posterior at the configuration that was drawn about
    elsewhere : where one joint of the configuration that was drawn about could as well be
    log_evidence : of the mode: logarithm of the posterior's integral over it, up to what is the same for all modes
    log_room : logarithm of the volume that its joint positions fill, before they were bent, likewise
    effective_sample_size : how many draws of equal weight would tell as much
    """

    roots: Array
    joints: Array
    log_weights: Array
    about: Held
    middle: Array
    held_stds: Array
    nuisances: Array | None
    middle_nuisances: Array | None
    nats: float
    elsewhere: Elsewhere
    log_evidence: float
    log_room: float
    effective_sample_size: float


@dataclass(frozen=True)
class Better:
    """A configuration (7,), (D,) that is so much better than another that draws about this say nothing."""

    root: Array
    joints: Array


def mode_draws(
    rng: np.random.Generator, problem: Problem, root: Array, joints: Array, checkpoint: Checkpoint = go_on
) -> ModeDraws:
    """Draws about a mode's best configuration (7,), (D,). Raises what `checkpoint` does, called before each round."""
    found = draws_or_better(rng, problem, root, joints, checkpoint, np.inf)
    assert isinstance(found, ModeDraws)
    return found


def draws_or_better(
    rng: np.random.Generator, problem: Problem, root: Array, joints: Array, checkpoint: Checkpoint, surpassed: float
) -> ModeDraws | Better:
    """As `mode_draws`, or the first configuration that turns out to be better by more than `surpassed` nats."""
    model = problem.mrf.model
    free = np.flatnonzero(problem.nuisance_std)
    about = held(problem, root, joints)
    information = curvature_information(problem, about, problem.tolerance_end, free, LOOSE)
    density = _density(problem, about, free, checkpoint)
    size = len(information)
    here = float(density(np.zeros((1, size)))[0])
    covariance = measured_covariance(density, here, np.asarray(np.linalg.inv(information), dtype=np.float64))
    elsewhere = joints_elsewhere(problem, about, here, np.diag(information)[6 : 6 + model.dof] ** -0.5)
    if elsewhere.nats - here > surpassed:
        return _better(model, about, elsewhere.best)
    lower, upper = _limits(problem, joints, len(free))
    first = Proposal(np.zeros(size), covariance, lower, upper, elsewhere.grids)
    # scales and sizes go far together with the root, and proposals are long in following them; cameras do not
    scales, _, sizes = split(problem.nuisance_std, len(problem.observation.views))
    power = MOST_POWER if scales.any() or sizes.any() else min(MOST_POWER, POWER * (6 + model.dof))
    counts = (FIRST, *[max(LEAST, size * min(size, EACH))] * (ROUNDS - 1))
    least = SETTLED * size * (size + 1) // 2
    drawn = adaptive_importance(
        rng, density, first, counts, ENOUGH / power, least_power=power, least=least, high=here + surpassed
    )
    dof, weights = 6 + model.dof, np.exp(drawn.log_weights)
    best = int(drawn.log_density.argmax())
    if drawn.log_density[best] - here > surpassed:
        return _better(model, about, drawn.rows[best, :dof])
    # what the image hides of what priors tell is not hidden
    known = linalg.block_diag(prior_information(problem, about), np.diag(problem.nuisance_std[free] ** -2.0))
    middle, hidden = weights @ drawn.rows, blunted(grain(problem, about), known)
    covariance = np.einsum("k,ki,kj->ij", weights, drawn.rows - middle, drawn.rows - middle) + hidden
    middle, covariance, nuisances = middle[:dof], covariance[:dof, :dof], _nuisances(problem, free, middle[None, dof:])
    roots, q, others = _stirred(rng, problem, about, drawn.rows, hidden)
    return ModeDraws(
        roots=roots,
        joints=_bent(rng, problem, about, middle, covariance, (roots, q)),
        log_weights=drawn.log_weights,
        about=about,
        middle=middle,
        middle_nuisances=None if nuisances is None else nuisances[0],
        held_stds=_held_stds(covariance),
        nuisances=_nuisances(problem, free, others),
        nats=here,
        elsewhere=elsewhere,
        log_evidence=drawn.log_integral,
        log_room=_log_room(weights, q),
        effective_sample_size=drawn.effective_sample_size,
    )


def _better(model: ArticulatedObject, about: Held, offsets: Array) -> Better:
    """The configuration at offsets (6 + D,)."""
    roots, q = about.placed(offsets[None])
    return Better(roots[0], within_limits(q[0], model.lower, model.upper, model.wraps))


def _held_stds(covariance: Array) -> Array:
    """(P,) standard deviations of each coordinate of a Gaussian of a covariance (P, P) where all others are held; of a
    joint whose limits are one position next to none."""
    stds, correlation = standardised(covariance)
    found: Array = stds / np.sqrt(np.diag(np.linalg.inv(correlation)))
    return found


def misfit(nats: float) -> float:
    """Nats of evidence that count as one, between places of a posterior that is so high."""
    return 1.0 + MISFIT * abs(nats)


def _stirred(
    rng: np.random.Generator, problem: Problem, about: Held, rows: Array, hidden: Array
) -> tuple[Array, Array, Array]:
    """Root poses (K, 7), joint vectors (K, D) and free nuisances (K, F) at offsets (K, 6 + D + F) and what a covariance
    (6 + D + F, 6 + D + F) hides, by any turn that nothing tells."""
    model = problem.mrf.model
    values, axes = np.linalg.eigh(hidden)
    # the symmetric root: axes of equal variance are any
    stir = rng.standard_normal((len(rows), len(values))) @ (axes * np.sqrt(np.maximum(values, 0.0))) @ axes.T
    moves, moved, others = np.split(rows + stir, [6, 6 + model.dof], axis=1)
    q = within_limits(about.joints + moved, model.lower, model.upper, model.wraps)
    roots = about.roots(moves, q)
    if isinstance(problem.prior, UniformPrior) and (spin := free_turn(model)):
        roots, q = turned_anyhow(rng, model, spin, roots, q)
    return roots, within_limits(q, model.lower, model.upper, model.wraps), others


def _bent(
    rng: np.random.Generator,
    problem: Problem,
    about: Held,
    middle: Array,
    covariance: Array,
    draws: tuple[Array, Array],
) -> Array:
    """Joint vectors (K, D) of draws, bent otherwise where their middle (6 + D,) may be: nats count there as between
    places."""
    mrf, model = problem.mrf, problem.mrf.model
    root, joints = about.placed(middle[None])
    joints = within_limits(joints, model.lower, model.upper, model.wraps)
    motions = bends(mrf, root[0], joints[0])
    if not motions:
        return draws[1]
    if about.part:
        covariance = about.by_root @ covariance @ about.by_root.T
    share = 1 / misfit(float(log_posterior(problem, root, joints)[0]))
    at = (root[0], joints[0])
    return bent_otherwise(rng, mrf, motions, at, covariance, draws, lambda *some: share * log_posterior(problem, *some))


def _log_room(weights: Array, joints: Array) -> float:
    """Logarithm of the volume that joint positions (K, D) of `weights` (K,) fill, up to what is the same for all."""
    gap = joints - weights @ joints
    spread = np.einsum("k,ki,kj->ij", weights, gap, gap) + SHUT**2 * np.eye(gap.shape[1])
    return float(np.linalg.slogdet(spread)[1] / 2)


def drawn_nuisance_stds(problem: Problem, draws: ModeDraws) -> Array | None:
    """(K,) standard deviations of the nuisances in draws; None where all are fixed."""
    if draws.nuisances is None:
        return None
    weights, drawn = np.exp(draws.log_weights), draws.nuisances
    # what no image tells was stirred, too
    found: Array = np.minimum(np.sqrt(weights @ (drawn - weights @ drawn) ** 2), problem.nuisance_std)
    return found


def nuisance_stds(problem: Problem, root: Array, joints: Array) -> Array:
    """(K,) standard deviations of the nuisances near an estimate (7,), (D,), all else free to follow: those of the
    Gaussian that has the curvature of the score. Outlines are left out, which tell more."""
    free = np.flatnonzero(problem.nuisance_std)
    stds = np.zeros_like(problem.nuisance_std)
    place = Held(problem.mrf, 0, root, joints)
    covariance = np.linalg.inv(curvature_information(problem, place, problem.tolerance_end, free, UNTOLD))
    stds[free] = np.sqrt(np.diag(covariance)[6 + len(joints) :])
    return stds


def _density(problem: Problem, about: Held, free: NDArray[np.int64], checkpoint: Checkpoint) -> LogDensity:
    """The log posterior of offsets (C, 6 + D + F) to a configuration and to the `free` nuisances (F,); `checkpoint` is
    called before each lot of them."""
    model = problem.mrf.model
    lower, upper = _limits(problem, about.joints, len(free))

    def log_density(offsets: Array) -> Array:
        checkpoint()
        found = np.full(len(offsets), -np.inf)
        inside = np.all((offsets >= lower) & (offsets <= upper), axis=1)
        if inside.any():
            roots, q = about.placed(offsets[inside, : 6 + model.dof])
            turned = within_limits(q, model.lower, model.upper, model.wraps)
            nuisances = _nuisances(problem, free, offsets[inside, 6 + model.dof :])
            found[inside] = log_posterior(problem, roots, turned, nuisances)
        return found

    return log_density


def _limits(problem: Problem, joints: Array, free: int) -> tuple[Array, Array]:
    """Least and largest offsets (6 + D + F,) of root, joints and free nuisances."""
    model = problem.mrf.model
    reach = np.concatenate([np.full(3, ASTRAY), np.full(3, np.pi)])
    turns = np.where(model.wraps, np.inf, 0.0)
    others = np.full(free, np.inf)
    return (
        np.concatenate([-reach, model.lower - joints - turns, -others]),
        np.concatenate([reach, model.upper - joints + turns, others]),
    )


def _nuisances(problem: Problem, free: NDArray[np.int64], offsets: Array) -> Array | None:
    """(C, K): the problem's, the `free` ones (F,) moved by `offsets` (C, F); None where all are fixed."""
    if problem.nuisances is None:
        return None
    moved = np.tile(problem.nuisances, (len(offsets), 1))
    moved[:, free] += offsets
    # a share beyond this turns the object inside out
    return np.clip(moved, -0.9, 0.9)
