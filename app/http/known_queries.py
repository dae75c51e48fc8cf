"""Does a call know what it is asked? A query parameter that it has no use for is refused: `maxstd=0.001` for `max_std`
would else be answered by the default, and a planner would act on it.
"""

from __future__ import annotations

from fastapi import Request, params
from fastapi.dependencies.utils import get_flat_params
from fastapi.routing import APIRoute

from app.problems import HttpProblem


async def only_known_queries(request: Request) -> None:
    """HttpProblem 422 for a query parameter that the route of the request does not declare."""
    asked = request.query_params.keys()
    if not asked:
        return
    route = request.scope.get("route")
    if not isinstance(route, APIRoute):
        return
    fields = get_flat_params(route.dependant)
    known = [field.alias for field in fields if isinstance(field.field_info, params.Query)]
    for name in asked:
        if name not in known:
            there = f"those of this call are {', '.join(known)}" if known else "this call has none"
            raise HttpProblem(422, f"'{name:.80}' is no query parameter; {there}")
