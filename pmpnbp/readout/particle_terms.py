"""Why does a particle weigh what it does, and where does it come from? The terms of its log weight, and its origin.

Iterations of the search have no messages: the particles of one hypothesis (`Origin.island`) share its whole-object
score. Nor has the particle filter: potential, prior and weight are those of the whole object.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmpnbp.inference.belief import FLIP, NEIGHBOUR, OWN, START, IterationReport
from pmpnbp.inference.problem import Problem


@dataclass(frozen=True, kw_only=True)
class MessageTerm:
    """An incoming message's share in a log weight.

    sender : the part that sent it
    log_unary, log_neighbour : its two factors there, the latter from the messages of the sender's other neighbours
    joint_draw : the joint draw that explains the sender best, metres or radians by joint axis
    """

    sender: str
    log_share: float
    log_unary: float
    log_neighbour: float
    joint_draw: dict[str, float]


@dataclass(frozen=True, kw_only=True)
class Terms:
    """The terms of a log weight: it is the sum of `log_potential` and `constant`.

    unary : the log unary potential, tempered; prior : 0 where the part has no such factor
    constant : what normalises the weights of the part; in the search also what the whole object's score adds
    """

    unary: float
    prior: float
    messages: tuple[MessageTerm, ...]
    constant: float

    @property
    def log_potential(self) -> float:
        """The log weight before normalisation."""
        return self.unary + self.prior + sum(message.log_share for message in self.messages)


def terms(problem: Problem, report: IterationReport, node: int, particle: int) -> Terms:
    """The terms of the log weight of a part's particle."""
    belief = report.belief
    unary = float(report.inverse_temperature[node] * belief.log_unary[node, particle])
    prior = _log_prior(problem, report, node, particle)
    messages = tuple(_message_terms(problem, report, node, particle))
    rest = float(belief.log_weights[node, particle]) - unary - prior
    return Terms(
        unary=unary, prior=prior, messages=messages, constant=rest - sum(message.log_share for message in messages)
    )


def ancestor_part(report: IterationReport, node: int, particle: int) -> int:
    """The part whose particle of the iteration before the `ancestor` of a particle is."""
    belief = report.belief
    return int(belief.origin.neighbour[node, particle]) if belief.origin.source[node, particle] == NEIGHBOUR else node


def origin(problem: Problem, report: IterationReport, node: int, particle: int) -> str:
    """Where a particle comes from, one sentence."""
    belief, model = report.belief, problem.mrf.model
    source, ancestor = int(belief.origin.source[node, particle]), int(belief.origin.ancestor[node, particle])
    own, before = model.parts[node].name, report.iteration - 1
    if source == START:
        return "It was placed at the start." if report.iteration == 0 else "It was drawn anew from the prior."
    if source == NEIGHBOUR:
        lender = ancestor_part(report, node, particle)
        between = (edge for edge in model.edges if {edge.parent, edge.child} == {node, lender})
        joints = " and ".join(joint.name for edge in list(between)[:1] for joint in model.edge_joints(edge))
        return (
            f"It was proposed through {joints or 'a joint'} from {model.parts[lender].name}: particle {ancestor} of "
            f"{model.parts[lender].name} in iteration {before}, with a position of the joint drawn anew."
        )
    if source == OWN and ancestor >= 0:
        return f"It descends from particle {ancestor} of {own} in iteration {before}, moved by the diffusion."
    if source == FLIP:
        descent = f" from particle {ancestor} of iteration {before}" if ancestor >= 0 else ""
        return f"It belongs to a hypothesis of the whole object that was flipped{descent}."
    if source == OWN:
        return f"It was drawn from {own}'s own belief."
    return "It belongs to a hypothesis that puts oriented surface points of a part on oriented points of the scan."


def _message_terms(problem: Problem, report: IterationReport, node: int, particle: int) -> list[MessageTerm]:
    mrf, messages, shares = problem.mrf, report.messages, report.log_message_shares[node, particle]
    if messages is None:
        return []
    model, samples = mrf.model, messages.poses.shape[1]
    pooled = samples != report.belief.log_weights.shape[1]
    entries = []
    for place, message in enumerate(mrf.incoming[node]):
        if np.isnan(shares[place]):
            continue  # pooled: this particle is another message's
        # pooled samples stand message after message, shared ones have the same number in all
        row = particle - place * samples if pooled else particle
        drawn = messages.joint_draw[message, row].tolist()
        entries.append(
            MessageTerm(
                sender=model.parts[mrf.sender[message]].name,
                log_share=float(shares[place]),
                log_unary=float(messages.log_unary[message, row]),
                log_neighbour=float(messages.log_neighbour[message, row]),
                # not strict: all edges draw as many numbers as the longest has axes
                joint_draw=dict(zip(model.edge_axis_names(model.edges[mrf.edge[message]]), drawn, strict=False)),
            )
        )
    return entries


def _log_prior(problem: Problem, report: IterationReport, node: int, particle: int) -> float:
    if report.iteration == 0 or (node != problem.prior_node and report.stage != "particle filter"):
        return 0.0
    return float(problem.plus_prior(np.zeros(()), report.belief.poses[problem.prior_node, particle]))
