"""Results: what a session has found, at any of its iterations."""

from __future__ import annotations

import threading
import time
from contextlib import nullcontext
from typing import Annotated, Literal

import anyio.to_thread
import numpy as np
from fastapi import APIRouter, Query, Request, Response

from app import schemas_results as schemas
from app.documentation import answer
from app.particle_files import Format, written
from app.problems import HttpProblem, responses
from app.routes.named import Link, NamedRoute
from app.routes.parameters import (
    LINK_NAMES,
    Iteration,
    SessionId,
    find_source,
    read_out,
    sessions_of,
    told,
    told_of_links,
)
from app.routes.particle_answers import FILES, FormatQuery, file_of, members_of
from app.routes.turns import short_turn
from app.sessions.source import Source
from pmpnbp.json_text import json_bytes
from pmpnbp.readout.coordinates import coordinates
from pmpnbp.readout.posterior import Posterior
from pmpnbp.readout.snapshot import Snapshot

router = APIRouter(prefix="/api/v1/sessions/{session_id}", tags=["results"], route_class=NamedRoute)

Wait = Literal["certain", "converged", "idle"]


@router.get(
    "/estimate",
    response_class=Response,
    summary="Where every link is, and how sure that is",
    responses=answer("The estimate.", model=schemas.Estimate) | responses(404, 409),
)
async def get_estimate(
    session_id: SessionId,
    request: Request,
    iteration: Iteration = None,
    wait: Annotated[Wait | None, Query(description="what to wait for; with `iteration` nothing is waited for")] = None,
    timeout: Annotated[float, Query(ge=0, le=600, description="seconds to wait, at most")] = 30.0,
    posterior: Annotated[
        bool, Query(description="read the posterior out though the inference is not at rest in that iteration")
    ] = False,
) -> Response:
    """result.json with `session_id` and `state`. With `wait` the answer comes as soon as that is so, or the session
    does not iterate, or the time is over; the answer itself tells which. Members of the posterior are null before the
    inference is at rest, unless `posterior` asks for them; during the search there is none."""
    session = await find_source(request, session_id)
    if iteration is not None:
        async with short_turn(request):
            snapshot = await anyio.to_thread.run_sync(session.archive.read, iteration)
    else:
        snapshot = await _newest(session, wait, timeout)
        if wait is not None and session.closed and not sessions_of(request).closed:
            raise HttpProblem(404, f"session '{session_id}' was deleted while it was waited for")
    outdated = session.archive.changed_since(snapshot.iteration)
    tail = json_bytes({"session_id": session.id, "state": session.state, "outdated": outdated})
    if posterior:
        snapshot = await read_out(request, session, snapshot)
    snapshot.asked.set()
    text = snapshot.known_text
    if text is None:
        # the newest's is made once for all, and nobody waits for another one's
        async with nullcontext() if snapshot is session.archive.present else short_turn(request):
            text = await anyio.to_thread.run_sync(_text, snapshot)
    return Response(text[:-1] + b"," + tail[1:], media_type="application/json")


def _text(snapshot: Snapshot) -> bytes:
    return snapshot.result_text


async def _newest(session: Source, wait: Wait | None, timeout: float) -> Snapshot:
    """At once where it was asked for before, else from a thread."""
    if wait is not None:
        await anyio.to_thread.run_sync(_await, session, wait, timeout)
    present = session.archive.present
    return await anyio.to_thread.run_sync(session.archive.read) if present is None else present


def _await(session: Source, wait: Wait, timeout: float) -> None:
    changed = threading.Event()
    end = session.events.listen(changed.set)
    try:
        until = time.monotonic() + timeout
        while not (session.idle or session.events.closed or (wait != "idle" and session.progress()[wait])):
            left = until - time.monotonic()
            if left <= 0:
                return
            changed.wait(left)
            changed.clear()
    finally:
        end()


@router.get(
    "/posterior/{link:path}",
    response_class=Response,
    summary="Where a link may be, given the scan",
    responses=answer("The draws.", model=schemas.PosteriorDraws, content=FILES)
    | responses(409, status_404="The session, the link or the iteration is not here, or it is of the search."),
)
async def get_posterior(
    session_id: SessionId, link: Link, request: Request, iteration: Iteration = None, form: FormatQuery = "json"
) -> Response:
    """Draws of the posterior: poses of the link in world, metres, with log weights. Draw i of every link is of one
    configuration of the whole object. During the search there is none; before rest it is read out for this call."""
    session, snapshot = await told(request, session_id, iteration, [link])
    async with short_turn(request):
        return await anyio.to_thread.run_sync(_draws, session, snapshot, link, form)


def _draws(session: Source, snapshot: Snapshot, link: str, form: Format) -> Response:
    posterior, model = _posterior_of(snapshot), snapshot.problem.mrf.model
    draws = posterior.link_poses(model)[:, model.links.index(link)]
    members = members_of(session, snapshot) | {"link": link, "posterior_iteration": posterior.iteration}
    columns = {"log_weights": posterior.log_weights, "mode": posterior.mode}
    return file_of(f"{link}-{snapshot.iteration}-posterior", written(members, draws, columns, form), form)


@router.get(
    "/posterior",
    response_class=Response,
    summary="What the scan leaves open, number by number",
    responses=answer("The draws.", model=schemas.PosteriorCoordinates, content=FILES)
    | responses(409, status_404="The session, a link or the iteration is not here, or it is of the search."),
)
async def get_posterior_coordinates(
    session_id: SessionId,
    request: Request,
    iteration: Iteration = None,
    links: Annotated[
        list[str] | None,
        Query(max_length=1000, description=f"{LINK_NAMES}; default: the joints alone", examples=[["drawer2"]]),
    ] = None,
    form: Annotated[
        Literal["json", "npz"],
        Query(
            alias="format",
            description="json; npz with the arrays `particles` (K, L, 7), poses x y z qw qx qy qz of `links`, all "
            "where none are named, `joint_positions` (K, D) of `joints`, `log_weights` and `mode` (K,)",
        ),
    ] = "json",
) -> Response:
    """Positions of the joints, and where the asked links are and how they are turned, in every draw of the posterior:
    what to set against each other, to see what the scan ties together."""
    session, snapshot, asked = await told_of_links(request, session_id, iteration, links)
    async with short_turn(request):
        return await anyio.to_thread.run_sync(_coordinates if form == "json" else _all_draws, session, snapshot, asked)


def _coordinates(session: Source, snapshot: Snapshot, asked: list[str]) -> Response:
    posterior = _posterior_of(snapshot)
    found = coordinates(snapshot.problem.mrf.model, posterior, snapshot.placed, asked)
    members = {
        "session_id": session.id,
        "iteration": snapshot.iteration,
        "posterior_iteration": posterior.iteration,
        "log_weights": posterior.log_weights.tolist(),
        "mode": posterior.mode.tolist(),
        "coordinates": [vars(one) | {"values": one.values.tolist()} for one in found],
    }
    return Response(json_bytes(members), media_type="application/json")


def _all_draws(session: Source, snapshot: Snapshot, asked: list[str]) -> Response:
    posterior, model = _posterior_of(snapshot), snapshot.problem.mrf.model
    links = asked or [*model.links]
    poses_world_link = posterior.link_poses(model)[:, [model.links.index(link) for link in links]]
    members = members_of(session, snapshot) | {
        "posterior_iteration": posterior.iteration,
        "links": links,
        "joints": np.array(model.coordinate_names, dtype=str),
    }
    columns = {"joint_positions": posterior.drawn_joints, "log_weights": posterior.log_weights, "mode": posterior.mode}
    return file_of(f"{snapshot.iteration}-posterior", written(members, poses_world_link, columns, "npz"), "npz")


def _posterior_of(snapshot: Snapshot) -> Posterior:
    """The posterior of a snapshot that was read out. HttpProblem 404 during the search."""
    posterior = snapshot.placed.posterior
    if posterior is None:
        raise HttpProblem(404, f"iteration {snapshot.iteration} ({snapshot.report.stage}) has no posterior")
    return posterior
