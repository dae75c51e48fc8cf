"""Regions of interest: what stands in a session's scans, and may be what it looks for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from threading import Condition
from typing import Annotated, Any

from cachetools import LRUCache, cached
from fastapi import APIRouter, Path, Query, Request
from pydantic import BaseModel, Field

from app.problems import responses
from app.routes.parameters import SourceId, sessions_of
from app.routes.turns import LongTurnRoute
from app.schemas import MOST_SCANS
from app.sessions.source import Source
from app.store.store import Store
from app.uploads.parsers import Parsers
from app.uploads.summaries import regions

# Models with their scans whose regions are remembered: whoever opens the set-up again need not wait.
KEPT = 64

router = APIRouter(prefix="/api/v1", route_class=LongTurnRoute)

_ANSWERS = responses(404, 409, 507, status_503="The process that looks for them was killed; ask again.")


class ProposedRegion(BaseModel):
    """A thing that stands in the scans."""

    roi: list[float] = Field(
        description="x0 y0 z0 x1 y1 z1, metres in world: the box around its points, 10 cm larger on every side, and "
        "around the model where that fits",
        min_length=6,
        max_length=6,
        examples=[[-0.1, -0.2, -0.1, 0.9, 0.7, 0.9]],
    )
    size: list[float] = Field(
        description="metres, of its points: its height, and the longer and the shorter side of its footprint",
        min_length=3,
        max_length=3,
        examples=[[0.74, 0.69, 0.48]],
    )
    points: float = Field(description="share of the measured points that are its, 0 to 1", examples=[0.3])
    unlikeness: float = Field(
        description="by how much its size is unlike the model's over its joints' ranges, and the model laid on it is "
        "off its points or seen through; 0 for not at all",
        examples=[0.2],
    )


class ProposedRegions(BaseModel):
    """What stands there."""

    regions: list[ProposedRegion] = Field(description="the likest the model first; empty where nothing stands out")


@router.get(
    "/sessions/{session_id}/regions",
    response_model=ProposedRegions,
    tags=["sessions"],
    summary="What stands in its scans",
    responses=_ANSWERS,
)
def get_regions(session_id: SourceId, request: Request) -> Any:
    """The things that stand out of floor, walls and table tops in the session's scans, at most six: boxes for `roi`.
    They are told by their places, their sizes and a coarse fit of the model, so that a person or a program has to
    choose. A large thing, or one that touches others, may come in pieces or with its neighbours."""
    source = sessions_of(request).get(session_id)
    status = source.status()
    if status["model_id"]:
        return _found(request, status["model_id"], status["scan_ids"])
    return _of_recording(source)


@router.get(
    "/models/{model_id}/regions",
    response_model=ProposedRegions,
    tags=["models"],
    summary="Where it may stand in scans",
    responses=_ANSWERS,
)
def find_model(
    model_id: Annotated[str, Path(description="id of the model", examples=["0123456789abcdef"])],
    scan_id: Annotated[
        list[Annotated[str, Field(max_length=64)]],
        Query(min_length=1, max_length=MOST_SCANS, description="of each scan, views of one scene in one world frame"),
    ],
    request: Request,
) -> Any:
    """The same before there is a session: where in the scans the model may be, and so which `roi` a session is to have.
    Whoever asks again, or a session of the same model and scans, has the answer at once."""
    return _found(request, model_id, list(dict.fromkeys(scan_id)))


def _found(request: Request, model_id: str, scan_ids: Sequence[str]) -> dict[str, Any]:
    store: Store = request.app.state.store
    parsers: Parsers = request.app.state.parsers
    files = store.file("models", model_id), [store.file("scans", id) for id in scan_ids]
    return _kept((model_id, *scan_ids), lambda: parsers.regions(*files))


def _of_recording(source: Source) -> dict[str, Any]:
    def look() -> dict[str, Any]:
        problem = source.archive.read().problem
        return regions([source.scan(view)[1] for view in range(problem.observation.scan_count)], problem.mrf.model)

    return _kept((source.id,), look)


# asked for by the start page, too, beside the making of the session, so that its page waits for less
@cached(LRUCache(KEPT), key=lambda looked_at, _: looked_at, condition=Condition())
def _kept(looked_at: tuple[str, ...], look: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What `look` finds, once for what has the ids `looked_at`."""
    return look()
