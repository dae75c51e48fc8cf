"""Is the server alive, is it ready, and what does it do? For orchestrators and for Prometheus."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from fastapi import APIRouter, Request, Response
from fastapi.responses import PlainTextResponse
from prometheus_client import CONTENT_TYPE_PLAIN_0_0_4, CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.registry import Collector
from pydantic import BaseModel, Field
from starlette.datastructures import State

from app.memory import resident_bytes
from app.problems import HttpProblem, responses
from pmpnbp.version import version

router = APIRouter(tags=["health"])

_STARTED = time.time()


class Health(BaseModel):
    """That the process answers."""

    status: str = Field(description='"ok"', examples=["ok"])
    version: str = Field(description="version of the server", examples=["0.1.0"])
    ready: bool = Field(description="whether its kernels are compiled, as `/readyz` has it")


@router.get("/healthz", summary="Is the server alive?")
def get_health(request: Request) -> Health:
    """Answers as long as the process does. Needs no token."""
    return Health(status="ok", version=version(), ready=request.app.state.ready)


@router.get(
    "/readyz",
    summary="Is the server ready?",
    responses=responses(status_503="kernels are still being compiled, or the server stops"),
)
def get_readiness(request: Request) -> Health:
    """200 once kernels are compiled and the store is open; 503 before, and while stopping. Needs no token."""
    if not request.app.state.ready:
        raise HttpProblem(503, "the kernels are still being compiled", headers={"Retry-After": "5"})
    return Health(status="ok", version=version(), ready=True)


@router.get(
    "/metrics",
    summary="Figures for Prometheus",
    response_class=PlainTextResponse,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}, "description": "text format 0.0.4"}},
)
def get_metrics(request: Request) -> Response:
    """Requests, clients, sessions by state, memory in bytes and seconds since the start, as Prometheus' text."""
    registry = CollectorRegistry()  # the library's own is the process's, which may have several apps
    registry.register(_Figures(request.app.state))
    return Response(generate_latest(registry), media_type=CONTENT_TYPE_PLAIN_0_0_4)


@dataclass(frozen=True)
class _Figures(Collector):
    """What an app does at the moment."""

    state: State

    def collect(self) -> Iterator[Metric]:
        """Each figure, with its help."""
        state = self.state
        yield InfoMetricFamily("pmpnbp", "which version runs", {"version": version()})
        yield GaugeMetricFamily("pmpnbp_ready", "1 once kernels are compiled and the store is open", state.ready)
        yield GaugeMetricFamily("pmpnbp_uptime_seconds", "since the server was started", time.time() - _STARTED)
        yield GaugeMetricFamily("pmpnbp_resident_memory_bytes", "of the server's process", resident_bytes())
        yield GaugeMetricFamily("pmpnbp_stored_bytes", "in the data directory", state.store.used_bytes())
        yield GaugeMetricFamily(
            "pmpnbp_clients", "requests, streams and 3D views now open", state.traffic.connected.all
        )
        yield GaugeMetricFamily("pmpnbp_connections", "open, idle ones among them", len(state.connections))
        ended = CounterMetricFamily(
            "pmpnbp_connections_ended", "refused, or ended by the server, by reason", labels=["reason"]
        )
        for reason, count in sorted(state.connections.ended.items()):
            ended.add_metric([reason], count)
        yield ended
        requests = CounterMetricFamily(
            "pmpnbp_http_requests", "requests answered, by method and status", labels=["method", "status"]
        )
        for (method, status), count in sorted(state.traffic.requests.items()):
            requests.add_metric([method, str(status)], count)
        yield requests
        sessions = GaugeMetricFamily("pmpnbp_sessions", "sessions kept, by state", labels=["state"])
        for name, count in sorted(Counter(document["state"] for document in state.sessions.list()).items()):
            sessions.add_metric([name], count)
        yield sessions
