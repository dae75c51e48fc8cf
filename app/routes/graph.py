"""The Markov random field of a session: parts as nodes, joints as edges, and the colours that they have everywhere."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request

from app.problems import responses
from app.routes.parameters import SessionId, sessions_of
from app.routes.turns import ShortTurnRoute
from app.schemas_particles import Graph
from pmpnbp.pictures.palette import hexadecimal, part_colour, part_colour_on_dark
from pmpnbp.readout.result import number_or_list
from pmpnbp.scene.articulated_object import Joint

router = APIRouter(prefix="/api/v1/sessions/{session_id}", tags=["results"], route_class=ShortTurnRoute)


@router.get("/graph", response_model=Graph, summary="Parts and joints as a graph", responses=responses(404, 409))
def get_graph(session_id: SessionId, request: Request) -> Any:
    """The Markov random field: links that move as one are a part, a node; the joints between two parts are an edge,
    along which two messages go."""
    session = sessions_of(request).get(session_id)
    problem = session.archive.read().problem
    model = problem.mrf.model
    parts = [
        {
            "name": part.name,
            "links": list(part.links),
            "visible": part.visible,
            "colour": hexadecimal(part_colour(number)),
            "colour_dark": hexadecimal(part_colour_on_dark(number)),
        }
        for number, part in enumerate(model.parts)
    ]
    edges = [
        {
            "parent": model.parts[edge.parent].name,
            "child": model.parts[edge.child].name,
            "joints": [_joint(joint) for joint in model.edge_joints(edge)],
        }
        for edge in model.edges
    ]
    views = problem.observation.scan_count
    return {"session_id": session.id, "parts": parts, "edges": edges, "views": views, "truth": session.truth_known}


def _joint(joint: Joint) -> dict[str, Any]:
    lower, upper = joint.limits()
    return {"name": joint.name, "type": joint.kind, "lower": number_or_list(lower), "upper": number_or_list(upper)}
