"""One link's belief, looked at closely: marginals, its heaviest particles, and why one of them weighs what it does."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Path, Query, Request, Response

from app.json_text import without_nan
from app.pictures.particle_picture import LONGEST, NARROWEST, particle_picture
from app.problems import HttpProblem, responses
from app.routes.parameters import Iteration, Link, SessionId, read
from app.schemas import answer
from app.schemas_particles import HeaviestParticles, Marginals, ParticleReasons
from app.sessions.readable import Readable, no_view
from app.sessions.snapshot import Snapshot
from pmpnbp.inference.belief import FLIP, NEIGHBOUR, OWN, SOURCES, START
from pmpnbp.readout.estimate import parts_of_links
from pmpnbp.readout.marginals import marginals
from pmpnbp.scene.articulated_object import Edge

router = APIRouter(prefix="/api/v1", tags=["results"])

Index = Annotated[int, Path(ge=0, le=2**31, description="number of the particle, counted from 0")]
_NOT_HERE = responses(409, status_404="The session, the link or the iteration is not here.")
_NO_PARTICLE = responses(409, status_404="The session, the link, the iteration or the particle is not here.")


@router.get(
    "/sessions/{session_id}/beliefs/{link}/marginals",
    response_model=Marginals,
    operation_id="get_marginals",
    summary="The belief about a link, one number at a time",
    description="Weighted histograms of position, of roll, pitch and yaw, and of the joints that the link's part hangs "
    "on.",
    responses=_NOT_HERE,
)
def get_marginals(
    session_id: SessionId,
    link: Link,
    request: Request,
    iteration: Iteration = None,
    bins: Annotated[int, Query(ge=1, le=400, description="bars of each histogram")] = 40,
) -> Any:
    """The histograms."""
    session, made = read(request, session_id, iteration, [link])
    found = [
        {
            "name": one.name,
            "unit": one.unit,
            "edges": one.edges.tolist(),
            "density": one.density.tolist(),
            "estimate": one.estimate,
        }
        for one in marginals(made.problem, made.report, link, bins, made.placed)
    ]
    return _head(session, made, link) | {"marginals": found}


@router.get(
    "/sessions/{session_id}/beliefs/{link}/particles",
    response_model=HeaviestParticles,
    operation_id="get_heaviest_particles",
    summary="The heaviest particles of a belief",
    description="With their weights and where each was proposed from.",
    responses=_NOT_HERE,
)
def get_heaviest_particles(
    session_id: SessionId,
    link: Link,
    request: Request,
    iteration: Iteration = None,
    limit: Annotated[int, Query(ge=1, le=20_000, description="particles, at most")] = 50,
) -> Any:
    """The best of them."""
    session, made = read(request, session_id, iteration, [link])
    node = _node(made, link)
    heaviest = np.argsort(-made.report.belief.log_weights[node], kind="stable")[:limit]
    poses_world_link = made.placed.particles[:, made.problem.mrf.model.links.index(link)]
    found = [_particle(made, node, int(index)) | {"pose": poses_world_link[index].tolist()} for index in heaviest]
    count = int(made.report.belief.log_weights.shape[1])
    return without_nan(_head(session, made, link) | {"count": count, "particles": found})


@router.get(
    "/sessions/{session_id}/beliefs/{link}/particles/{index}",
    response_model=ParticleReasons,
    operation_id="get_particle",
    summary="Why a particle weighs what it does",
    description="Where it comes from, and the terms of its log weight: the unary potential, the prior and each "
    "incoming message.",
    responses=_NO_PARTICLE,
)
def get_particle(session_id: SessionId, link: Link, index: Index, request: Request, iteration: Iteration = None) -> Any:
    """The terms."""
    session, made = read(request, session_id, iteration, [link])
    node = _node(made, link)
    _check_index(made, index)
    model, belief = made.problem.mrf.model, made.report.belief
    why = session.why(made, model.parts[node].name, index)
    pose = made.placed.particles[index, model.links.index(link)]
    unary = why["temperature"] * why["log_unary"]
    shares = {sender["from"]: sender["log_share"] for sender in why["messages"]}
    joints = None if belief.joint_positions is None else model.joint_values(belief.joint_positions[index])
    return without_nan(
        _head(session, made, link)
        | _particle(made, node, index)
        | {
            "pose": pose.tolist(),
            "stage": why["stage"],
            "origin": _origin(made, node, index),
            "ancestor_part": why["ancestor_part"],
            "island": why["island"],
            "temperature": why["temperature"],
            "log_potential": unary + why["log_prior"] + sum(shares.values()),
            "shares": {
                "unary": unary,
                "prior": why["log_prior"],
                "messages": shares,
                "constant": why["log_constant"],
            },
            "messages": [
                {**sender, "joint_draw": _axes(made, node, sender["from"], sender["joint_draw"])}
                for sender in why["messages"]
            ],
            "joint_positions": None if joints is None else {name: _number(moved) for name, moved in joints.items()},
        }
    )


@router.get(
    "/sessions/{session_id}/beliefs/{link}/particles/{index}/picture.png",
    response_class=Response,
    operation_id="get_particle_picture",
    summary="What speaks for a particle in a scan, and what against",
    description="Three panels: the observed depth, that of the link's part rendered alone at the particle's pose, and "
    "what the pixel score makes of their difference: explained, seen through (free space violated), something in "
    "front, on a support plane, no depth. In the pixels of the inference's working image, cut out around the part.",
    responses=answer("The picture.", content={"image/png": {"schema": {"type": "string", "format": "binary"}}})
    | responses(409, status_404="The session, the link, the iteration, the particle or the view is not here."),
)
def get_particle_picture(
    session_id: SessionId,
    link: Link,
    index: Index,
    request: Request,
    iteration: Iteration = None,
    view: Annotated[int, Query(ge=0, le=2**31, description="which of the scans, counted from 0")] = 0,
    width: Annotated[int, Query(ge=NARROWEST, le=LONGEST, description="pixels; the height follows")] = 720,
    theme: Annotated[Literal["light", "dark"], Query(description="of the page it is for")] = "light",
) -> Response:
    """Draw it."""
    session, made = read(request, session_id, iteration, [link])
    _check_index(made, index)
    views = len(made.problem.observation.views)
    if view >= views:
        raise no_view(session, view, views)
    picture = particle_picture(
        made.problem, made.report, _node(made, link), index, view=view, width=width, dark=theme == "dark"
    )
    return Response(picture, media_type="image/png")


def _head(session: Readable, made: Snapshot, link: str) -> dict[str, Any]:
    part = made.problem.mrf.model.parts[_node(made, link)].name
    return {"session_id": session.id, "iteration": made.iteration, "link": link, "part": part}


def _node(made: Snapshot, link: str) -> int:
    return parts_of_links(made.problem.mrf.model)[link]


def _check_index(made: Snapshot, index: int) -> None:
    count = made.report.belief.log_weights.shape[1]
    if index >= count:
        raise HttpProblem(404, f"particle {index} is not here; a part has particles 0 to {count - 1}")


def _particle(made: Snapshot, node: int, index: int) -> dict[str, Any]:
    belief, parts = made.report.belief, made.problem.mrf.model.parts
    log_weight, ancestor = float(belief.log_weights[node, index]), int(belief.ancestor[node, index])
    lender = int(belief.neighbour[node, index])
    return {
        "index": index,
        "weight": float(np.exp(log_weight)),
        "log_weight": log_weight,
        "log_unary": float(belief.log_unary[node, index]),
        "source": SOURCES[int(belief.source[node, index])],
        "neighbour": parts[lender].name if lender >= 0 else None,
        "ancestor": ancestor if ancestor >= 0 else None,
    }


def _origin(made: Snapshot, node: int, index: int) -> str:
    """Where a particle comes from, one sentence."""
    belief, model = made.report.belief, made.problem.mrf.model
    source, ancestor = int(belief.source[node, index]), int(belief.ancestor[node, index])
    own, before = model.parts[node].name, made.iteration - 1
    if source == START:
        return "It was placed at the start." if made.iteration == 0 else "It was drawn anew from the prior."
    if source == NEIGHBOUR:
        lender = int(belief.neighbour[node, index])
        joints = " and ".join(joint.name for joint in _joints(made, node, lender))
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


def _edge(made: Snapshot, node: int, other: int) -> Edge | None:
    edges = made.problem.mrf.model.edges
    return next((edge for edge in edges if {edge.parent, edge.child} == {node, other}), None)


def _joints(made: Snapshot, node: int, other: int) -> tuple[Any, ...]:
    edge = _edge(made, node, other)
    return () if edge is None else made.problem.mrf.model.edge_joints(edge)


def _axes(made: Snapshot, node: int, sender: str, drawn: list[float]) -> dict[str, float]:
    """The joint draw of a message by joint; of a joint with several axes by each of them."""
    model = made.problem.mrf.model
    other = next(number for number, part in enumerate(model.parts) if part.name == sender)
    edge = _edge(made, node, other)
    # not strict: all edges draw as many numbers as the longest has axes
    return {} if edge is None else dict(zip(model.edge_axis_names(edge), drawn, strict=False))


def _number(moved: Any) -> float | list[float]:
    numbers: list[float] = moved.tolist()
    return numbers[0] if len(numbers) == 1 else numbers
