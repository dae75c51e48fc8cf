"""The server: what it is made of, what happens when it starts and when it stops. Wiring only."""

from __future__ import annotations

import functools
import logging
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import anyio.to_thread
from fastapi import Depends, FastAPI

from app import compiled_kernels, documentation, problems, warm_up
from app.http.bodies import Bodies
from app.http.connections import connections_for
from app.http.head import Head
from app.http.known_queries import only_known_queries
from app.page_cookie import page_cookie
from app.rate_limit import RateLimit, Traffic
from app.routes import (
    beliefs,
    decisions,
    events,
    graph,
    health,
    models,
    particles,
    pictures,
    recordings,
    regions,
    results,
    samples,
    scans,
    session_recordings,
    sessions,
    settings,
    start_page,
    views,
)
from app.routes.turns import Turns
from app.security import Access, Headers
from app.server_config import ServerConfig
from app.sessions.sessions import Sessions
from app.store.store import Store
from app.uploads.parsers import Parsers
from app.uploads.uploads import Uploads, parsers_for
from app.viewer import proxy
from app.viewer.views import Views
from pmpnbp.pictures.pictures import Pictures
from pmpnbp.version import version

# In the order of the documentation: the calls, and what is asked for beside them.
CALLS = (
    models.router,
    scans.router,
    sessions.router,
    samples.router,
    graph.router,
    # before the beliefs: a belief's particles are no link's name
    particles.router,
    beliefs.router,
    regions.router,
    results.router,
    session_recordings.router,
    decisions.router,
    pictures.router,
    events.router,
    views.router,
    recordings.router,
    settings.router,
)
BESIDE = health.router, start_page.router, proxy.router
# Where a POST brings a file, which may be larger than JSON and is written to disk as it comes.
UPLOADS = frozenset(f"/api/v1/{kind}" for kind in ("models", "scans", "recordings"))

_log = logging.getLogger("pmpnbp.server")


def create_app(config: ServerConfig, parsers: Parsers | None = None) -> FastAPI:
    """The application for `config`; nothing is opened before it starts.

    parsers : who reads uploads, where several applications of one process share them: closed by whoever made them
    """
    app = FastAPI(
        title="pmpnbp",
        version=version(),
        lifespan=_life,
        docs_url=None,
        redoc_url=None,
        openapi_url="/openapi.json",
        redirect_slashes=False,
        generate_unique_id_function=lambda route: route.name,  # an operation is called as its function is
    )
    app.state.config = config
    app.state.shared_parsers = parsers
    app.state.traffic = Traffic()
    app.state.connections = connections_for(config)
    app.state.long_turns = Turns()
    app.state.short_turns = Turns()
    app.state.ready = False
    app.state.stopping = False
    app.state.open = False

    problems.install(app)
    app.add_middleware(Head)
    app.add_middleware(Bodies, config=config, uploads=UPLOADS)
    app.add_middleware(Access, config=config)
    app.add_middleware(RateLimit, config=config, traffic=app.state.traffic)
    app.add_middleware(Headers)  # added last, so outermost: refusals carry them too

    for router in CALLS:
        app.include_router(router, dependencies=[Depends(only_known_queries)])
    for router in BESIDE:
        app.include_router(router)
    documentation.install(app)
    return app


@asynccontextmanager
async def _life(app: FastAPI) -> AsyncIterator[None]:
    config: ServerConfig = app.state.config
    # Calls that wait for an estimate hold a thread each; the default of 40 would let them block all others.
    anyio.to_thread.current_default_thread_limiter().total_tokens = config.max_clients + 40
    if not app.state.open:
        await anyio.to_thread.run_sync(open_all, app)
    threading.Thread(target=_get_ready, args=(app,), name=compiled_kernels.WARM_UP, daemon=True).start()
    try:
        yield
    finally:
        await anyio.to_thread.run_sync(close_all, app)


def open_all(app: FastAPI) -> None:
    """Open the store, and with it every session, paused where it was. Raises PmpnbpError where that cannot be."""
    config: ServerConfig = app.state.config
    app.state.store = Store(config.data_dir, config.max_disk_bytes)
    if config.token is not None:
        app.state.page_cookie = page_cookie(config.data_dir, config.token)
    app.state.parsers = app.state.shared_parsers or parsers_for(config)
    app.state.uploads = Uploads(app.state.store, config, app.state.parsers)
    app.state.sessions = Sessions(app.state.store, config)
    app.state.sessions.restore()
    app.state.pictures = Pictures()
    app.state.views = Views(config.max_views, config.max_views_full_rate)
    app.state.open = True


def end_streams(app: FastAPI) -> None:
    """Pause and keep every session, which ends its event streams; end the 3D views. A second time does nothing."""
    app.state.ready = False
    if not app.state.stopping:
        app.state.stopping = True
        app.state.sessions.close()
        app.state.views.close()


def close_all(app: FastAPI) -> None:
    """End what streams, then close what answers the last calls. A second time does nothing."""
    if app.state.open:
        app.state.open = False
        end_streams(app)
        if app.state.parsers is not app.state.shared_parsers:
            app.state.parsers.close()
        app.state.pictures.close()
        app.state.store.close()


def _get_ready(app: FastAPI) -> None:
    """Compile kernels or load them from disk; then the sample session, where it was asked for."""
    try:
        # the first upload need not wait for its reader's imports
        app.state.parsers.warm()
        _kernels()
        try:
            if app.state.config.demo and not app.state.stopping:
                app.state.sessions.demo()
        finally:
            app.state.ready = not app.state.stopping
    except Exception:
        _log.exception("the server does not get ready")


@functools.cache
def _kernels() -> None:
    """Once for the process, however many servers run in it."""
    warm_up.run()
