"""State, opening and closing of the line."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Request

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import NO_SIGN_IN, App, AuditNote, CurrentUser, User, need
from gss.api.one_at_a_time import OneAtATime
from gss.api.schemas.link import CountersOut, LinkOpenIn, LinkOut
from gss.device.line_address import LineAddress, parse_line_address
from gss.operations.line.addresses import is_allowed, not_allowed
from gss.wiring.services import Services

router = api_router("link")


@router.get("/health", dependencies=[need(NO_SIGN_IN)])
def health() -> dict[str, str]:
    """Liveness check. It returns no other data, because it needs no sign-in."""
    return {"status": "ok"}


@router.get("/link")
def read_link(app: App) -> LinkOut:
    """Contents of the header bar."""
    return present.link.link(app.upkeep.status.header())


@router.get("/link/counters")
def read_counters(app: App) -> CountersOut:
    """Counters of both directions."""
    return present.link.counters(
        app.line.link.contact_counters, app.line.link.session.framing, app.line.link.session.housekeeping
    )


async def _opening(request: Request) -> OneAtATime:
    line_opening: OneAtATime = request.app.state.line_opening
    return line_opening


@router.post("/link/open", dependencies=[need("link.open")])
async def open_link(
    app: App,
    caller: CurrentUser,
    body: LinkOpenIn,
    audit_note: AuditNote,
    opening: Annotated[OneAtATime, Depends(_opening)],
) -> LinkOut:
    """Switch to another port. If it cannot be opened, the error is returned immediately and the current port stays
    open. Only one line is opened at a time. A user who is not an admin can open a remote address only if the settings
    permit the address or it was opened before."""

    def open_now() -> LinkOut:
        audit_note(f"from {_port(app)} to {body.url}")
        app.commanding.authority.check(caller.name)
        address = parse_line_address(body.url)
        if caller.role != "admin" and not _is_known(app, address):
            raise not_allowed(body.url)
        app.line.link.open(body.url)
        return present.link.link(app.upkeep.status.header())

    return await opening.run(open_now)


@router.post("/link/acknowledge-dictionary", dependencies=[need("link.open")])
def acknowledge_dictionary(app: App, user: User, audit_note: AuditNote) -> LinkOut:
    """Accept that the device has a different dictionary. Commands are blocked until a user accepts it."""
    audit_note(
        f"ours {app.line.link.dictionary.hash_hex}, the device's {app.line.link.session.device_dictionary_hash or 'unknown'}"
    )
    app.commanding.authority.check(user)
    app.line.link.acknowledge_dictionary(user)
    return present.link.link(app.upkeep.status.header())


@router.post("/link/close", dependencies=[need("link.open")])
def close_link(app: App, user: User, audit_note: AuditNote) -> LinkOut:
    """Close the port."""
    audit_note(_port(app))
    app.commanding.authority.check(user)
    app.line.link.close()
    return present.link.link(app.upkeep.status.header())


def _is_known(app: Services, address: LineAddress) -> bool:
    allowed, url = is_allowed(address, app.base.settings.link_allow), address.text
    return allowed or url == app.base.settings.device or app.contacts.contacts.had(url)


def _port(app: Services) -> str:
    return app.line.link.url if app.line.link.connected else "closed"
