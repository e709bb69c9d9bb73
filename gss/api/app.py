"""The HTTP application: routers, error handlers, guards and the web pages."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import cast

import anyio.to_thread
from fastapi import APIRouter, Depends, FastAPI
from fastapi.responses import HTMLResponse

from gss import __version__
from gss.api import errors, stored_words
from gss.api.counting import Counting, kinds_of
from gss.api.deps import view_by_default
from gss.api.files.compress import Compress
from gss.api.files.pages import Pages
from gss.api.guard import door, security
from gss.api.one_at_a_time import OneAtATime
from gss.api.routers import (
    alarms,
    analyses,
    audit,
    authority,
    calibrations,
    campaigns,
    catalogues,
    commands,
    contacts,
    design,
    events,
    frames,
    help,
    jobs,
    limits,
    link,
    rerun,
    schedule,
    session,
    sky,
    solutions,
    stacks,
    tables,
    telemetry,
    tokens,
    transfers,
    upkeep,
    users,
)
from gss.api.stream import route as stream
from gss.api.stream.fanout import Fanout
from gss.api.stream.presenter import Presenter, first_state
from gss.api.workers.forward import Forward, Gateway
from gss.api.workers.upstream import Upstream
from gss.wiring import Services

PAGES = Path(__file__).parent.parent / "web"
WITHOUT_PAGES = (
    "<h1>GSS</h1><p>The pages have not been built. Try: make web. "
    "What the server offers is in <a href='/api/openapi.json'>/api/openapi.json</a>.</p>"
)


def create_app(services: Services, pages: Path = PAGES, behind: Path | None = None) -> FastAPI:
    """Return the application for connected services; its lifespan starts and stops them. ``behind``: build the
    application of an API worker, whose services only read; the path is the Unix socket of the link process."""
    state = None if behind else lambda: first_state(services.status)
    fanout = Fanout(services.streams, state, services.settings.streams_each, services.settings.streams_most)

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        await anyio.to_thread.run_sync(services.start)
        presenter = Presenter(services.bus, fanout, services.stopping)
        presenter.start(asyncio.get_running_loop())
        yield
        await anyio.to_thread.run_sync(services.stop)
        presenter.stop()

    @asynccontextmanager
    async def reading(_app: FastAPI) -> AsyncIterator[None]:
        upstream = Upstream(cast(Path, behind), fanout)
        await upstream.start()
        yield
        await upstream.stop()
        services.database.close()

    app = FastAPI(
        title="GSS",
        version=__version__,
        description="Ground-support system for star trackers.",
        lifespan=lifespan if behind is None else reading,
        docs_url=None,
        redoc_url=None,
        openapi_url="/api/openapi.json",
        redirect_slashes=False,  # a redirect would contain the internal address behind a proxy
        responses=errors.PROBLEMS,
    )
    app.state.services, app.state.fanout = services, fanout
    app.state.line_opening = OneAtATime("open link", "another line is being opened", "wait some seconds and try again")
    stored_words.install(services)
    errors.install(app)
    errors.describe(app)
    app.add_middleware(Compress)
    if behind is not None:
        app.add_middleware(Gateway, forward=Forward(behind))
    security.install(app)
    api = APIRouter(prefix="/api", dependencies=[Depends(view_by_default)])
    for module in (
        session,
        users,
        tokens,
        audit,
        authority,
        schedule,
        stacks,
        link,
        commands,
        tables,
        telemetry,
        limits,
        alarms,
        frames,
        solutions,
        catalogues,
        design,
        calibrations,
        analyses,
        campaigns,
        transfers,
        jobs,
        events,
        contacts,
        sky,
        rerun,
        upkeep,
        stream,
    ):
        api.include_router(module.router)
    door.check_routes(api)
    app.include_router(api)
    app.include_router(upkeep.root)
    app.include_router(help.router)
    app.add_middleware(Counting, metrics=services.upkeep.metrics, kinds=kinds_of(app))
    _serve_pages(app, pages)
    return app


def _serve_pages(app: FastAPI, pages: Path) -> None:
    if (pages / "index.html").exists():
        app.router.default = Pages(pages)  # after every route; also serves paths that the pages' script routes itself
        return

    @app.get("/", include_in_schema=False)
    def missing() -> HTMLResponse:
        return HTMLResponse(WITHOUT_PAGES)
