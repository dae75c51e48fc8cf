"""One link's belief, looked at closely: marginals, its heaviest particles, and why one of them weighs what it does."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Path, Query, Request, Response

from app.documentation import PICTURE
from app.problems import HttpProblem, responses
from app.routes.named import Link
from app.routes.parameters import Iteration, SessionId, read
from app.routes.turns import ShortTurnRoute
from app.schemas_particles import HeaviestParticles, Marginals, ParticleReasons
from app.sessions.source import Source, no_view
from pmpnbp.inference.belief import SOURCES
from pmpnbp.json_text import without_nan
from pmpnbp.pictures.particle_picture import LONGEST, NARROWEST, particle_picture
from pmpnbp.readout.marginals import marginals
from pmpnbp.readout.particle_terms import ancestor_part, origin, terms
from pmpnbp.readout.result import number_or_list
from pmpnbp.readout.snapshot import Snapshot
from pmpnbp.scene.articulated_object import parts_of_links

router = APIRouter(prefix="/api/v1/sessions/{session_id}", tags=["results"], route_class=ShortTurnRoute)

Index = Annotated[int, Path(ge=0, le=2**31, description="number of the particle, counted from 0")]
_NOT_HERE = responses(409, status_404="The session, the link or the iteration is not here.")
_NO_PARTICLE = responses(409, status_404="The session, the link, the iteration or the particle is not here.")


@router.get(
    "/beliefs/{link:path}/marginals",
    response_model=Marginals,
    summary="The belief about a link, one number at a time",
    responses=_NOT_HERE,
)
def get_marginals(
    session_id: SessionId,
    link: Link,
    request: Request,
    iteration: Iteration = None,
    bins: Annotated[int, Query(ge=1, le=400, description="bars of each histogram")] = 40,
) -> Any:
    """Weighted histograms of position, of roll, pitch and yaw, and of the joints that the link's part hangs on."""
    session, snapshot = read(request, session_id, iteration, [link])
    found = [
        vars(one) | {"edges": one.edges.tolist(), "density": one.density.tolist()}
        for one in marginals(snapshot.problem, snapshot.report, link, bins, snapshot.placed)
    ]
    return _head(session, snapshot, link) | {"marginals": found}


@router.get(
    "/beliefs/{link:path}/particles",
    response_model=HeaviestParticles,
    summary="The heaviest particles of a belief",
    responses=_NOT_HERE,
)
def get_heaviest_particles(
    session_id: SessionId,
    link: Link,
    request: Request,
    iteration: Iteration = None,
    limit: Annotated[int, Query(ge=1, le=20_000, description="particles, at most")] = 50,
) -> Any:
    """With their weights and where each was proposed from."""
    session, snapshot = read(request, session_id, iteration, [link])
    node = _node(snapshot, link)
    heaviest = np.argsort(-snapshot.report.belief.log_weights[node], kind="stable")[:limit]
    poses_world_link = snapshot.placed.particles[:, snapshot.problem.mrf.model.links.index(link)]
    found = [_particle(snapshot, node, int(index)) | {"pose": poses_world_link[index].tolist()} for index in heaviest]
    count = int(snapshot.report.belief.log_weights.shape[1])
    return without_nan(_head(session, snapshot, link) | {"count": count, "particles": found})


@router.get(
    "/beliefs/{link:path}/particles/{index}",
    response_model=ParticleReasons,
    summary="Why a particle weighs what it does",
    responses=_NO_PARTICLE,
)
def get_particle(session_id: SessionId, link: Link, index: Index, request: Request, iteration: Iteration = None) -> Any:
    """Where it comes from, and the terms of its log weight: the unary potential, the prior and each incoming
    message."""
    session, snapshot = read(request, session_id, iteration, [link])
    node = _node(snapshot, link)
    _check_index(snapshot, index)
    problem, report = snapshot.problem, snapshot.report
    model, joint_positions = problem.mrf.model, report.belief.joint_positions
    found = terms(problem, report, node, index)
    joints = None
    if joint_positions is not None:
        joints = {name: number_or_list(moved) for name, moved in model.joint_values(joint_positions[index]).items()}
    return without_nan(
        _head(session, snapshot, link)
        | _particle(snapshot, node, index)
        | {
            "pose": snapshot.placed.particles[index, model.links.index(link)].tolist(),
            "stage": report.stage,
            "origin": origin(problem, report, node, index),
            "ancestor_part": model.parts[ancestor_part(report, node, index)].name,
            "island": int(report.belief.origin.island[node, index]),
            "temperature": float(report.inverse_temperature[node]),
            "log_potential": found.log_potential,
            "shares": vars(found) | {"messages": {message.sender: message.log_share for message in found.messages}},
            "messages": [{"from": message.sender, **vars(message)} for message in found.messages],
            "joint_positions": joints,
        }
    )


@router.get(
    "/beliefs/{link:path}/particles/{index}/picture.png",
    response_class=Response,
    summary="What speaks for a particle in a scan, and what against",
    responses=PICTURE
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
    """Three panels: the observed depth, that of the link's part rendered alone at the particle's pose, and what the
    pixel score makes of their difference: explained, seen through (free space violated), something in front, on a
    support plane, no depth. In the pixels of the inference's working image, cut out around the part."""
    session, snapshot = read(request, session_id, iteration, [link])
    _check_index(snapshot, index)
    observation, node = snapshot.problem.observation, _node(snapshot, link)
    if view >= observation.scan_count:
        raise no_view(session, view, observation.scan_count)
    if view not in observation.scan_numbers:
        raise HttpProblem(404, f"view {view} of {session.kind} '{session.id}' shows nothing of the region of interest")
    own = observation.scan_numbers.index(view)
    picture = particle_picture(
        snapshot.problem, snapshot.report, node, index, view=own, width=width, dark=theme == "dark"
    )
    return Response(picture, media_type="image/png")


def _head(session: Source, snapshot: Snapshot, link: str) -> dict[str, Any]:
    part = snapshot.problem.mrf.model.parts[_node(snapshot, link)].name
    return {"session_id": session.id, "iteration": snapshot.iteration, "link": link, "part": part}


def _node(snapshot: Snapshot, link: str) -> int:
    return parts_of_links(snapshot.problem.mrf.model)[link]


def _check_index(snapshot: Snapshot, index: int) -> None:
    count = snapshot.report.belief.log_weights.shape[1]
    if index >= count:
        raise HttpProblem(404, f"particle {index} is not here; a part has particles 0 to {count - 1}")


def _particle(snapshot: Snapshot, node: int, index: int) -> dict[str, Any]:
    belief, parts = snapshot.report.belief, snapshot.problem.mrf.model.parts
    log_weight, ancestor = float(belief.log_weights[node, index]), int(belief.origin.ancestor[node, index])
    lender = int(belief.origin.neighbour[node, index])
    return {
        "index": index,
        "weight": float(np.exp(log_weight)),
        "log_weight": log_weight,
        "log_unary": float(belief.log_unary[node, index]),
        "source": SOURCES[int(belief.origin.source[node, index])],
        "neighbour": parts[lender].name if lender >= 0 else None,
        "ancestor": ancestor if ancestor >= 0 else None,
    }
