"""Is the server alive, is it ready, and what does it do? For orchestrators and for Prometheus."""

from __future__ import annotations

import time
from collections import Counter
from pathlib import Path
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import PlainTextResponse
from pydantic import BaseModel, Field

from app.problems import HttpProblem, responses
from app.version import version

router = APIRouter(tags=["health"])

# By the convention of Prometheus' text format, version 0.0.4
_MEDIA_TYPE = "text/plain; version=0.0.4; charset=utf-8"
_STARTED = time.time()


class Health(BaseModel):
    """That the process answers."""

    status: str = Field(description='"ok"', examples=["ok"])
    version: str = Field(description="version of the server", examples=["0.1.0"])


@router.get("/healthz", summary="Is the server alive?", operation_id="get_health")
def get_health() -> Health:
    """Answers as long as the process does. Needs no token."""
    return Health(status="ok", version=version())


@router.get(
    "/readyz",
    summary="Is the server ready?",
    operation_id="get_readiness",
    responses=responses(status_503="kernels are still being compiled, or the server stops"),
)
def get_readiness(request: Request) -> Health:
    """200 once kernels are compiled and the store is open; 503 before, and while stopping. Needs no token."""
    if not request.app.state.ready:
        raise HttpProblem(503, "the kernels are still being compiled", headers={"Retry-After": "5"})
    return Health(status="ok", version=version())


@router.get(
    "/metrics",
    summary="Figures for Prometheus",
    operation_id="get_metrics",
    response_class=PlainTextResponse,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}, "description": "text format 0.0.4"}},
)
def get_metrics(request: Request) -> PlainTextResponse:
    """Requests, clients, sessions by state, memory in bytes and seconds since the start, as Prometheus' text."""
    state = request.app.state
    documents: list[dict[str, Any]] = state.sessions.list()
    lines = [
        *_metric("info", "gauge", "which version runs", [({"version": version()}, 1)]),
        *_metric("ready", "gauge", "1 once kernels are compiled and the store is open", [({}, int(state.ready))]),
        *_metric("uptime_seconds", "gauge", "since the server was started", [({}, round(time.time() - _STARTED, 3))]),
        *_metric("resident_memory_bytes", "gauge", "of the server's process", [({}, _resident_bytes())]),
        *_metric("stored_bytes", "gauge", "in the data directory", [({}, state.store.used_bytes())]),
        *_metric("clients", "gauge", "requests, streams and 3D views now open", [({}, state.traffic.connected)]),
        *_metric(
            "http_requests_total",
            "counter",
            "requests answered, by method and status",
            [
                ({"method": method, "status": str(status)}, count)
                for (method, status), count in sorted(state.traffic.requests.items())
            ],
        ),
        *_metric(
            "sessions",
            "gauge",
            "sessions kept, by state",
            [({"state": name}, count) for name, count in sorted(Counter(d["state"] for d in documents).items())],
        ),
    ]
    return PlainTextResponse("\n".join(lines) + "\n", media_type=_MEDIA_TYPE)


def _metric(name: str, kind: str, help_text: str, samples: list[tuple[dict[str, str], float]]) -> list[str]:
    lines = [f"# HELP pmpnbp_{name} {help_text}", f"# TYPE pmpnbp_{name} {kind}"]
    for labels, value in samples:
        inside = ",".join(f'{key}="{_escaped(text)}"' for key, text in labels.items())
        lines.append(f"pmpnbp_{name}{{{inside}}} {value}" if inside else f"pmpnbp_{name} {value}")
    return lines


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")


def _resident_bytes() -> int:
    """Of this process; 0 where the system does not tell."""
    try:
        for line in Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith("VmRSS:"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass
    return 0
