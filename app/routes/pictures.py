"""The estimate as a picture over the scan, for whoever has no browser."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from app.documentation import PICTURE
from app.problems import HttpProblem, responses
from app.routes.parameters import SessionId, read
from app.routes.turns import ShortTurnRoute
from pmpnbp.pictures.part_images import DrawingError
from pmpnbp.pictures.pictures import LONGEST, Pictures

router = APIRouter(prefix="/api/v1/sessions/{session_id}", tags=["results"], route_class=ShortTurnRoute)

NARROWEST = 32


@router.get(
    "/estimate.png",
    response_class=Response,
    summary="The estimate drawn over a scan",
    responses=PICTURE | responses(404, 409, status_503="This machine has no OpenGL to draw with."),
)
def get_estimate_picture(
    request: Request,
    session_id: SessionId,
    iteration: Annotated[int | None, Query(ge=0, description="number of the iteration; default: the newest")] = None,
    view: Annotated[int, Query(ge=0, description="which of the session's scans, counted from 0")] = 0,
    width: Annotated[
        int | None,
        Query(
            ge=NARROWEST,
            le=LONGEST,
            description="pixels; default: the camera's. At most the camera's, or 640 where that is less; what is more "
            "is drawn at that width",
        ),
    ] = None,
) -> Response:
    """The scan's depth in greys as its camera sees it, nearer is lighter, and over it the parts where the estimate has
    them, one colour each; where something stands in front of a part only a tint of it is drawn."""
    pictures: Pictures = request.app.state.pictures
    session, snapshot = read(request, session_id, iteration)
    scan_name, scan = session.scan(view, iteration)
    # an event's number is never used again, while iterations count anew after a reset
    name = (session_id, snapshot.row["event"], scan_name, width)
    picture = pictures.kept(name)
    if picture is None:
        model = snapshot.problem.mrf.model
        try:
            picture = pictures.draw(scan, model, snapshot.placed.part_poses, width, scan_name=scan_name)
        except DrawingError as error:
            raise HttpProblem(503, str(error)) from None
        pictures.keep(name, picture)
    return Response(picture, media_type="image/png")
