"""The HTTP application: routers, error handlers, guards and the web pages."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, cast

import anyio.to_thread
from fastapi import FastAPI
from fastapi.responses import HTMLResponse

from gss import __version__
from gss.api import errors
from gss.api.files.compress import Compress
from gss.api.files.pages import Pages
from gss.api.guard import route_table, security
from gss.api.one_at_a_time import OneAtATime
from gss.api.request_counts import Counting, kinds_of
from gss.api.routers import (
    alarms,
    analyses,
    attitudes,
    audit,
    authority,
    calibrations,
    campaigns,
    catalogues,
    commands,
    contacts,
    derived,
    design,
    events,
    frames,
    handover,
    heads,
    help,
    instruments,
    jobs,
    limits,
    link,
    list_runs,
    notifications,
    pass_plans,
    passes,
    procedures,
    rerun,
    schedule,
    session,
    sky,
    solutions,
    stars,
    tables,
    telemetry,
    tokens,
    transfers,
    upkeep,
    users,
    views,
)
from gss.api.routers import fleet as fleet_router
from gss.api.stream import route as stream
from gss.api.stream.broadcast import Broadcaster, Presenter, first_state
from gss.api.workers.gateway import Gateway, relayed
from gss.wiring.services import Services

if TYPE_CHECKING:
    from gss.api.units.fleet import Fleet
    from gss.api.workers.link_client import LinkProcessClient

PAGES = Path(__file__).parent.parent / "web"
WITHOUT_PAGES = (
    "<h1>GSS</h1><p>The pages have not been built. Run make web. "
    "The API is described in <a href='/api/openapi.json'>/api/openapi.json</a>.</p>"
)


def create_app(
    services: Services,
    pages: Path = PAGES,
    behind: LinkProcessClient | None = None,
    fleet: Fleet | None = None,
) -> FastAPI:
    """Return the HTTP application. Its lifespan starts and stops ``services``. ``behind``: client of the link process;
    set only for the application of an API worker, whose services only read. ``fleet``: units of the server; set only
    for the application of the front process."""
    state = None if behind else lambda: first_state(services.upkeep.status)
    broadcaster = Broadcaster(
        services.upkeep.streams, state, services.base.settings.streams_each, services.base.settings.streams_most
    )

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        await anyio.to_thread.run_sync(services.start)
        presenter = Presenter(services.base.bus, broadcaster, services.stopping)
        presenter.start(asyncio.get_running_loop())
        async with fleet.running() if fleet is not None else nullcontext():
            yield
        await anyio.to_thread.run_sync(services.stop)
        presenter.stop()

    @asynccontextmanager
    async def reading(_app: FastAPI) -> AsyncIterator[None]:
        async with relayed(cast("LinkProcessClient", behind), broadcaster):
            yield
        services.base.database.close()

    app = FastAPI(
        title="GSS",
        version=__version__,
        description="Ground software for star trackers.",
        lifespan=lifespan if behind is None else reading,
        docs_url=None,
        redoc_url=None,
        openapi_url="/api/openapi.json",
        redirect_slashes=False,  # a redirect would contain the internal address behind a proxy
        responses=errors.PROBLEMS,
    )
    app.state.services, app.state.broadcaster = services, broadcaster
    app.state.fleet = fleet
    app.state.line_opening = OneAtATime("open link", "another line is being opened", "try again in a few seconds")
    errors.install(app)
    errors.describe(app)
    app.add_middleware(Compress)
    if behind is not None:
        app.add_middleware(Gateway, link=behind)
    security.install(app)
    for module in (
        session,
        users,
        tokens,
        fleet_router,
        heads,
        audit,
        authority,
        schedule,
        procedures,
        link,
        commands,
        tables,
        derived,
        telemetry,
        limits,
        alarms,
        notifications,
        frames,
        attitudes,
        list_runs,
        solutions,
        catalogues,
        design,
        instruments,
        calibrations,
        analyses,
        campaigns,
        transfers,
        jobs,
        events,
        contacts,
        handover,
        passes,
        pass_plans,
        sky,
        stars,
        rerun,
        views,
        upkeep,
        stream,
    ):
        app.router.routes.extend(module.router.routes)
    app.router.routes.extend(upkeep.root.routes + help.listing.routes + help.router.routes)
    route_table.check_routes(app.router)
    app.add_middleware(Counting, metrics=services.upkeep.metrics, kinds=kinds_of(app))
    _serve_pages(app, pages)
    return app


def _serve_pages(app: FastAPI, pages: Path) -> None:
    if (pages / "index.html").exists():
        app.router.default = Pages(pages)  # used if no route matches; it also serves paths that the script routes
        return

    @app.get("/", include_in_schema=False)
    def missing() -> HTMLResponse:
        return HTMLResponse(WITHOUT_PAGES)
