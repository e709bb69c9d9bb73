"""The line: its state, opening and closing it."""

from __future__ import annotations

from fastapi import APIRouter

from gss.api import present
from gss.api.deps import NOBODY, App, User, need
from gss.api.schemas.link import CountersOut, LinkOpenIn, LinkOut

router = APIRouter(tags=["link"])


@router.get("/health", dependencies=[need(NOBODY)])
def health() -> dict[str, str]:
    """The server answers; it tells strangers no more than that."""
    return {"status": "ok"}


@router.get("/link")
def read_link(app: App) -> LinkOut:
    """Everything of the header bar."""
    return present.link.link(app.status.header())


@router.get("/link/counters")
def read_counters(app: App) -> CountersOut:
    """Everything counted in both directions."""
    return present.link.counters(app.link.contact_counters, app.link.framing, app.link.session.housekeeping)


@router.post("/link/open", dependencies=[need("link.open")])
def open_link(app: App, user: User, body: LinkOpenIn) -> LinkOut:
    """Use another port. What is wrong with it is said at once, and the present one stays."""
    app.authority.check(user)
    app.link.open(body.url)
    return present.link.link(app.status.header())


@router.post("/link/acknowledge-dictionary", dependencies=[need("link.open")])
def acknowledge_dictionary(app: App, user: User) -> LinkOut:
    """Accept that the device has another dictionary; commanding is blocked until then."""
    app.authority.check(user)
    app.link.acknowledge_dictionary(user)
    return present.link.link(app.status.header())


@router.post("/link/close", dependencies=[need("link.open")])
def close_link(app: App, user: User) -> LinkOut:
    """Give the port back."""
    app.authority.check(user)
    app.link.close()
    return present.link.link(app.status.header())
