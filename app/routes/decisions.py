"""Decisions: act on the estimate, look again and from where, or is the object not there?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import anyio.to_thread
import numpy as np
from fastapi import APIRouter, Query, Request

from app import schemas_results as schemas
from app.next_views import WORTH, next_views, ranking, uncertain
from app.problems import HttpProblem, responses
from app.routes.parameters import LINK_NAMES, Iteration, SessionId, told, told_of_links
from app.routes.turns import long_turn
from app.schemas import DecisionRequest
from app.sessions.source import Source
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.names import some_of
from pmpnbp.readout.posterior import TURN, Doubt
from pmpnbp.readout.result import pose_members
from pmpnbp.readout.sight import sights
from pmpnbp.readout.snapshot import Snapshot
from pmpnbp.readout.view_planning import PlannedView
from pmpnbp.scene.articulated_object import parts_of_links
from pmpnbp.settings import SessionOptions

router = APIRouter(prefix="/api/v1/sessions/{session_id}", tags=["results"])


@router.get(
    "/decision",
    response_model=schemas.Decision,
    summary="Act, or look again, and from where?",
    responses=responses(409, status_404="The session or a link is not here."),
)
async def get_decision(
    session_id: SessionId,
    request: Request,
    links: Annotated[
        list[str] | None, Query(max_length=1000, description=f"{LINK_NAMES}; default: all", examples=[["drawer3"]])
    ] = None,
    max_std: Annotated[
        float | None,
        Query(gt=0, le=1e6, description="metres; default: the session's", examples=[SessionOptions.max_std]),
    ] = None,
    iteration: Iteration = None,
) -> Any:
    """By the newest iteration, or the one that is named: act where every asked link is certain, no_fit where what
    should be seen is not seen, else look, with views from around the object, that tell most first. The posterior is
    read out for it, where the inference is not at rest; during the search there is none, and nothing to act on, nor is
    there by the newest iteration once scans or settings have changed."""
    session, snapshot, asked = await told_of_links(request, session_id, iteration, links)
    async with long_turn(request):
        return await anyio.to_thread.run_sync(_decided, session, snapshot, iteration, asked or None, max_std, None)


@router.post(
    "/decision",
    response_model=schemas.Decision,
    summary="Act, or from which of these places to look again?",
    responses=responses(409, status_404="The session or a link is not here."),
)
async def post_decision(session_id: SessionId, request: Request, body: DecisionRequest) -> Any:
    """The same with the planner's own views, each with a camera's pose in world and what it costs to get there: they
    are ranked by what they are expected to tell over their cost."""
    views = None if body.views is None else [PlannedView(_pose(view.pose), view.cost) for view in body.views]
    asked = None if body.links is None else list(dict.fromkeys(body.links))
    session, snapshot = await told(request, session_id, body.iteration, asked or ())
    async with long_turn(request):
        return await anyio.to_thread.run_sync(_decided, session, snapshot, body.iteration, asked, body.max_std, views)


def _decided(
    session: Source,
    snapshot: Snapshot,
    iteration: int | None,
    links: Sequence[str] | None,
    max_std: float | None,
    views: Sequence[PlannedView] | None,
) -> dict[str, Any]:
    asked = [*snapshot.problem.mrf.model.links] if links is None else [*links]
    limit = snapshot.criteria.max_std if max_std is None else max_std
    changed = session.archive.changed_since(snapshot.iteration)
    # what it was then, the iteration that is named still is; the newest may be another by now
    outdated = iteration is None and changed
    blocking = asked if outdated else uncertain(snapshot, asked, limit)
    action, reason = ("look", _outdated(snapshot)) if outdated else _action(snapshot, blocking, limit)
    wanted = (action == "look" and not outdated) or views is not None
    return {
        "session_id": session.id,
        "iteration": snapshot.iteration,
        "outdated": changed,
        "action": action,
        "reason": reason,
        "certain": not blocking,
        "max_std": limit,
        "links": asked,
        "blocking": blocking,
        "sight": _sight(snapshot, blocking),
        "views": _views(snapshot, blocking or asked, views, limit) if wanted else [],
    }


def _outdated(snapshot: Snapshot) -> str:
    return f"scans or settings have changed since iteration {snapshot.iteration}: the next one takes them in"


def _action(snapshot: Snapshot, blocking: list[str], max_std: float) -> tuple[str, str]:
    """What to do, and why."""
    posterior = snapshot.placed.posterior
    if posterior is None:
        return "look", f"iteration {snapshot.iteration} is of the search: nothing says yet how sure that is"
    if posterior.fit.verdict != "good":
        return "no_fit", posterior.fit.reason
    if not blocking:
        return "act", f"every asked link is known to {1000 * max_std:g} mm; {posterior.fit.reason}"
    rows = {name: row for row, name in enumerate(snapshot.problem.mrf.model.links)}
    doubts = snapshot.placed.doubts(max_std)

    def doubted(*why: Doubt) -> list[str]:
        return [link for link in blocking if any(doubts[one][rows[link]] for one in why)]

    found = []
    off, turned = doubted("std_xyz", "expected_add", "elsewhere", "turned"), f"{np.degrees(TURN * max_std):g}°"
    if off:
        also = f", or turned by more than {turned}" if doubted("turned") else ""
        found.append(f"{some_of(off)} may be off by more than {1000 * max_std:g} mm{also}")
    if alike := doubted("alike"):
        told = "no view would tell how these are turned, which look the same in other turns"
        found.append(f"{told}: {some_of(alike)}")
    if denied := doubted("denied"):
        found.append(f"the scan sees through these, or what they hang on: {some_of(denied)}")
    if beyond := doubted("outside_region"):
        found.append(f"the region of interest leaves these out, or what they hang on: {some_of(beyond)}")
    if doubted("draws"):
        found.append("too few draws of the posterior count for anything to be certain")
    return "look", "; ".join(found)


def _views(
    snapshot: Snapshot, links: Sequence[str], views: Sequence[PlannedView] | None, limit: float
) -> list[dict[str, Any]]:
    """The views, or the best of those around the object, by what they are expected to tell of the links that is not
    known to `limit`, metres."""
    posterior = snapshot.placed.posterior
    if posterior is None:
        return []
    found = next_views(snapshot, links, limit) if views is None else ranking(snapshot, posterior, links, views, limit)
    return [
        {
            "pose": pose_members(one.view.pose),
            "cost": one.view.cost,
            "expected_gain_nats": one.gain,
            "worthwhile": one.gain >= WORTH,
            "expected_std_xyz": dict(zip(links, one.std_xyz.tolist(), strict=True)),
        }
        for one in found
    ]


def _sight(snapshot: Snapshot, links: Sequence[str]) -> dict[str, Any]:
    """What hides each of the links, at the estimate; None for one that would cover no pixel anywhere."""
    if not links:
        return {}
    problem = snapshot.placed.problem
    parts, part_of = problem.mrf.model.parts, parts_of_links(problem.mrf.model)
    found = sights(problem, snapshot.placed.part_poses)
    told: dict[str, Any] = {}
    for link in links:
        sight = found[part_of[link]]
        behind = {} if sight is None else {parts[other].name: share for other, share in sight.behind.items()}
        told[link] = None if sight is None else vars(sight) | {"behind": behind}
    return told


def _pose(members: Any) -> Array:
    """(7,). HttpProblem 422 where the orientation is none."""
    place, turn = members.position, members.orientation
    pose = np.array([place.x, place.y, place.z, turn.w, turn.x, turn.y, turn.z])
    length = float(np.linalg.norm(pose[3:]))
    if abs(length - 1) > 1e-3:
        raise HttpProblem(422, f"a view's orientation has length {length:.4g}; expected a unit quaternion x, y, z, w")
    return poses.normalise(pose)
