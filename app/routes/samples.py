"""Sample sessions: which scenes there are, and one call that opens one."""

from __future__ import annotations

from typing import Any, Literal

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, Field

from app.problems import responses
from app.routes.once import Once
from app.routes.parameters import sessions_of
from app.routes.sessions import MADE
from app.schemas import Body, Session
from app.sessions.sample import SAMPLES
from app.store.idempotency import Call

router = APIRouter(prefix="/api/v1", tags=["sessions"])

Scene = Literal["open", "self_occluded", "arm", "blanket", "closed", "from_above", "door", "robot", "robot_partial"]


class SampleScene(BaseModel):
    """A scene of the sample data, with known truth."""

    scene: Scene = Field(description="what it is asked for by")
    name: str = Field(description="what its session is called", examples=[SAMPLES[0].name])
    about: str = Field(description="what is to be seen, one sentence")


class SampleRequest(Body):
    """Which sample."""

    scene: Scene = Field(description="as GET /api/v1/samples lists them", examples=["open"])
    run: bool = Field(True, description="whether to iterate at once, until the inference is at rest")


@router.get("/samples", response_model=list[SampleScene], summary="Scenes of the sample data")
def list_samples() -> Any:
    """Every scene that a sample session can look at."""
    return [{"scene": sample.scene, "name": sample.name, "about": sample.about} for sample in SAMPLES]


@router.post(
    "/sessions/sample",
    status_code=201,
    response_model=Session,
    summary="Open a sample session",
    responses=MADE | responses(409, 507),
)
def create_sample_session(body: SampleRequest, request: Request, response: Response, once: Once) -> Any:
    """A new session with model, scan, region of interest and truth of a sample scene, as it is before it iterates.
    Model and scan are kept once, however many sessions look at them."""

    def make(call: Call | None) -> dict[str, Any]:
        session = sessions_of(request).sample(body.scene, call)
        document = session.status()
        if body.run:
            session.run(until="converged")
        return document

    document = once.made(body, make)
    response.headers["Location"] = f"/api/v1/sessions/{document['id']}"
    return document
