"""What was recorded of an iteration: the beliefs, the messages, and how it went."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Query, Request, Response

from app import schemas_results as schemas
from app.documentation import answer
from app.particle_files import written
from app.problems import HttpProblem, responses
from app.routes.named import Link, two_names
from app.routes.parameters import Iteration, SessionId, check_links, read, sessions_of
from app.routes.particle_answers import FILES, FormatQuery, file_of, members_of
from app.routes.turns import ShortTurnRoute
from pmpnbp.geometry import poses
from pmpnbp.json_text import json_bytes
from pmpnbp.scene.articulated_object import parts_of_links

router = APIRouter(prefix="/api/v1/sessions/{session_id}", tags=["results"], route_class=ShortTurnRoute)


@router.get(
    "/beliefs/{link:path}",
    response_class=Response,
    summary="The belief about a link",
    responses=answer("The particles.", model=schemas.BeliefParticles, content=FILES)
    | responses(409, status_404="The session, the link or the iteration is not here."),
)
def get_belief(
    session_id: SessionId, link: Link, request: Request, iteration: Iteration = None, form: FormatQuery = "json"
) -> Response:
    """Its particles: poses of the link in world, metres, with log weights. Links that move as one part have the part's
    particles, carried to each of them."""
    session, snapshot = read(request, session_id, iteration, [link])
    model, belief = snapshot.problem.mrf.model, snapshot.report.belief
    node = parts_of_links(model)[link]
    particles = snapshot.placed.particles[:, model.links.index(link)]
    members = members_of(session, snapshot) | {"link": link, "part": model.parts[node].name}
    columns = {"log_weights": belief.log_weights[node], "log_unary": belief.log_unary[node]}
    return file_of(f"{link}-{snapshot.iteration}", written(members, particles, columns, form), form)


@router.get(
    "/messages/{sender:path}/{receiver:path}",
    response_class=Response,
    summary="What one part says about another",
    responses=answer("The particles.", model=schemas.MessageParticles, content=FILES)
    | responses(409, status_404="The session, a link or the iteration is not here, or no message goes there."),
)
def get_message(
    session_id: SessionId,
    sender: Annotated[str, Path(description="name of a link of the part that says it; a slash in it as %2F")],
    receiver: Annotated[str, Path(description="name of the link that it is about; likewise")],
    request: Request,
    iteration: Iteration = None,
    form: FormatQuery = "json",
) -> Response:
    """The message between two parts that a joint connects: poses of the receiver's link in world, metres, with log
    weights. A part is named by any of its links. The search and the particle filter send no messages."""
    session, snapshot = read(request, session_id, iteration)
    sender, receiver = two_names(f"{sender}/{receiver}", snapshot.problem.mrf.model.links)
    check_links(snapshot, [sender, receiver])
    parts, messages = snapshot.problem.mrf.model.parts, snapshot.report.messages
    if messages is None:
        raise HttpProblem(404, f"iteration {snapshot.iteration} ({snapshot.report.stage}) has no messages")
    pairs = list(zip(messages.sender.tolist(), messages.receiver.tolist(), strict=True))
    source, target = (
        next((n for n, part in enumerate(parts) if link in part.links), -1) for link in (sender, receiver)
    )
    if (source, target) not in pairs:
        known = [f"{parts[s].name} to {parts[r].name}" for s, r in pairs]
        raise HttpProblem(
            404, f"no message goes from '{sender:.60}' to '{receiver:.60}'; there are {', '.join(known) or 'none'}"
        )
    number, part = pairs.index((source, target)), parts[target]
    particles = poses.multiply(messages.poses[number], part.poses_part_link[part.links.index(receiver)])
    members = members_of(session, snapshot) | {"from": parts[source].name, "to": part.name, "link": receiver}
    columns = {
        "log_weights": messages.log_weights[number],
        "log_unary": messages.log_unary[number],
        "log_neighbour": messages.log_neighbour[number],
    }
    return file_of(f"{sender}-{receiver}-{snapshot.iteration}", written(members, particles, columns, form), form)


@router.get(
    "/trace",
    response_class=Response,
    summary="All iterations at a glance",
    responses=answer("The trace.", model=schemas.Trace) | responses(404, 409),
)
def get_trace(
    session_id: SessionId,
    request: Request,
    after: Annotated[int, Query(ge=-1, le=2**31, description="only iterations beyond this one")] = -1,
    last: Annotated[int | None, Query(ge=0, le=2**31, description="only iterations up to this one")] = None,
    limit: Annotated[
        int | None, Query(ge=1, le=2**31, description="rows, at most: of more, evenly chosen ones, and the last")
    ] = None,
) -> Response:
    """Per iteration: seconds, effective sample size by part, log-likelihood, standard deviations by link (metres), and
    ADD by part (metres) where the truth is known. Rows may be missing where a recording is damaged."""
    session = sessions_of(request).get(session_id)
    found = session.archive.rows(after, last)
    if limit is not None and len(found) > limit:
        found = [found[-1 - place] for place in range(0, len(found), -(-len(found) // limit))][::-1]
    rows = ",".join(found)
    head = json_bytes({"session_id": session.id, "changes": session.changes()})[:-1].decode()
    return Response(f'{head},"iterations":[{rows}]}}'.encode(), media_type="application/json")
