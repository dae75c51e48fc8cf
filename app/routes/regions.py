"""Regions of interest: what stands in a session's scans, and may be what it looks for."""

from __future__ import annotations

from collections.abc import Hashable
from threading import Condition
from typing import Any

from cachetools import LRUCache, cached
from fastapi import APIRouter, Request
from pydantic import BaseModel, Field

from app.problems import responses
from app.routes.parameters import SourceId, sessions_of
from app.routes.turns import LongTurnRoute
from app.sessions.source import Source
from pmpnbp.scene.region import Region
from pmpnbp.scene.regions import propose_regions

# Models with their scans whose regions are remembered: whoever opens the set-up again need not wait.
KEPT = 64

router = APIRouter(prefix="/api/v1/sessions/{session_id}", tags=["sessions"], route_class=LongTurnRoute)


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
    "/regions", response_model=ProposedRegions, summary="What stands in its scans", responses=responses(404, 409)
)
def get_regions(session_id: SourceId, request: Request) -> Any:
    """The things that stand out of floor, walls and table tops in the session's scans, at most six: boxes for `roi`.
    They are told by their places, their sizes and a coarse fit of the model, so that a person or a program has to
    choose. A large thing, or one that touches others, may come in pieces or with its neighbours."""
    return {
        "regions": [
            {
                "roi": one.roi.round(4).tolist(),
                "size": one.size.round(4).tolist(),
                "points": one.points,
                "unlikeness": one.unlikeness,
            }
            for one in _proposed(sessions_of(request).get(session_id))
        ]
    }


def _looked_at(source: Source) -> Hashable:
    """The model and the scans, by their ids; a recording has none, and keeps to its own."""
    status = source.status()
    return (status["model_id"] or source.id, *status["scan_ids"])


# asked for by the start page, too, as soon as a session is made, so that its page waits for less
@cached(LRUCache(KEPT), key=_looked_at, condition=Condition())
def _proposed(source: Source) -> list[Region]:
    problem = source.archive.read().problem
    # a scan that does not see the present region is in no view
    count = len(source.status()["scan_ids"]) or len(problem.observation.views)
    return propose_regions([source.scan(view)[1] for view in range(count)], problem.mrf.model)
