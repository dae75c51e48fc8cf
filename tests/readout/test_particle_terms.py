"""A particle's weight is the sum of its terms, and its origin is told in one sentence."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from pmpnbp.inference import run
from pmpnbp.inference.belief import NEIGHBOUR, OWN, SOURCES, IterationReport
from pmpnbp.inference.problem import Problem, build
from pmpnbp.readout.particle_terms import ancestor_part, origin, terms
from pmpnbp.scene.prior import GaussianPrior, UniformPrior
from tests.inference.small_worlds import cupboard, cupboard_truth, seen, settings

PARTICLES = 40


@cache
def iterations(
    prior: str, product: str = "shared", method: str = "pmpnbp"
) -> tuple[Problem, tuple[IterationReport, ...]]:
    """A cupboard with a slide and a hinge, from the start over two iterations of search to the fourth."""
    model = cupboard()
    root, joints = cupboard_truth()
    known = GaussianPrior(
        "link1", model.part_poses(root, joints)[1], np.full(3, 0.08), np.full(3, 0.15), {"slide": (0.2, 0.03)}
    )
    quick = settings(
        search_iterations=2,
        search_iterations_per_joint=0,
        search_proposals=300,
        splat_points=64,
        belief_product=product,
        prior_factor=True,
    )
    problem = build(
        model,
        seen(model, root, joints),
        known if prior == "gaussian" else UniformPrior("upright"),
        quick,
        particles=PARTICLES,
        seed=11,
        method=method,
    )
    return problem, tuple(run.iterate(problem, 4))


@pytest.mark.parametrize(("prior", "product"), [("uniform", "shared"), ("gaussian", "shared"), ("gaussian", "pooled")])
def test_the_terms_sum_to_the_weight(prior: str, product: str) -> None:
    """With one constant for all that were normalised together: those of a part, or of a message where sets are
    pooled."""
    problem, reports = iterations(prior, product)
    report = reports[4]
    assert report.stage == "belief propagation"
    for node, part in enumerate(problem.mrf.model.parts):
        constants: dict[tuple[str, ...], list[float]] = {}
        for particle, log_weight in enumerate(report.belief.log_weights[node]):
            if np.isneginf(log_weight):
                continue
            found = terms(problem, report, node, particle)
            assert found.unary == report.inverse_temperature[node] * report.belief.log_unary[node, particle]
            assert (found.prior < 0) == (prior == "gaussian" and part.name == "link1")
            assert log_weight == pytest.approx(found.log_potential + found.constant)
            constants.setdefault(tuple(message.sender for message in found.messages), []).append(found.constant)
            for message in found.messages if product == "shared" else ():
                assert message.log_share == pytest.approx(message.log_unary + message.log_neighbour)
        for alike in constants.values():
            np.testing.assert_allclose(alike, alike[0], atol=1e-8)
        senders = {"link0": {"link1", "link2"}}.get(part.name, {"link0"})
        expected = {tuple(sorted(senders))} if product == "shared" else {(sender,) for sender in senders}
        assert set(constants) == expected


def test_a_joint_draw_is_within_the_limits_of_the_joint_between() -> None:
    problem, reports = iterations("uniform")
    for node, names in enumerate([["slide", "hinge"], ["slide"], ["hinge"]]):
        for particle in range(PARTICLES):
            drawn = [message.joint_draw for message in terms(problem, reports[4], node, particle).messages]
            assert [list(one) for one in drawn] == [[name] for name in names]
            assert all(0 <= position <= 1.5 for one in drawn for position in one.values())


@pytest.mark.parametrize("prior", ["uniform", "gaussian"])
def test_the_terms_of_the_particle_filter_are_the_whole_objects(prior: str) -> None:
    """One constant for all parts, and one prior, whichever part is asked about."""
    problem, reports = iterations(prior, method="particle_filter")
    assert reports[4].stage == "particle filter"
    found = [[terms(problem, reports[4], node, particle) for particle in range(PARTICLES)] for node in range(3)]
    constants = [one.constant for of_part in found for one in of_part]
    np.testing.assert_allclose(constants, constants[0], atol=1e-8)
    assert not any(one.messages for of_part in found for one in of_part)
    priors = np.array([[one.prior for one in of_part] for of_part in found])
    assert np.ptp(priors, axis=0).max() == 0.0
    assert (np.ptp(priors) > 0) == (prior == "gaussian")


def test_the_origin_names_the_ancestor_and_the_joint() -> None:
    problem, reports = iterations("uniform")
    report, node = reports[4], 2
    lent, own = (int(np.flatnonzero(report.belief.origin.source[node] == source)[0]) for source in (NEIGHBOUR, OWN))
    assert (ancestor_part(report, node, lent), ancestor_part(report, node, own)) == (0, node)
    assert origin(problem, report, node, lent) == (
        f"It was proposed through hinge from link0: particle {report.belief.origin.ancestor[node, lent]} of link0 in "
        "iteration 3, with a position of the joint drawn anew."
    )
    assert origin(problem, report, node, own) == (
        f"It descends from particle {report.belief.origin.ancestor[node, own]} of link2 in iteration 3, moved by the "
        "diffusion."
    )


def test_start_and_search_have_origins_and_no_messages() -> None:
    problem, reports = iterations("uniform")
    assert origin(problem, reports[0], 0, 0) == "It was placed at the start."
    assert terms(problem, reports[0], 0, 0).messages == ()
    told = {SOURCES[reports[1].belief.origin.source[0, k]]: origin(problem, reports[1], 0, k) for k in range(PARTICLES)}
    assert told["surface"].startswith("It belongs to a hypothesis that puts oriented surface points of a part on")
    assert terms(problem, reports[1], 0, 0).messages == ()
