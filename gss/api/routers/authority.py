"""Command authority: who holds it, taking, releasing, breaking."""

from __future__ import annotations

from fastapi import APIRouter

from gss.api import present
from gss.api.deps import App, Deed, User, need
from gss.api.schemas.authority import AuthorityOut, BreakIn

router = APIRouter(tags=["authority"])


@router.get("/authority")
def read_authority(app: App, user: User) -> AuthorityOut:
    """Who may command, and who could before."""
    return present.authority.authority(app.authority.state(), user)


@router.post("/authority/take", dependencies=[need("authority.take")])
def take_authority(app: App, user: User) -> AuthorityOut:
    """Take it while nobody holds it."""
    return present.authority.authority(app.authority.take(user), user)


@router.post("/authority/release", dependencies=[need("authority.take")])
def release_authority(app: App, user: User) -> AuthorityOut:
    """Give it back."""
    return present.authority.authority(app.authority.release(user), user)


@router.post("/authority/break", dependencies=[need("authority.break")])
def break_authority(app: App, user: User, body: BreakIn, deed: Deed) -> AuthorityOut:
    """Take it from its holder, with a reason."""
    deed(f"of {app.authority.holder() or 'nobody'}, {body.reason}")
    return present.authority.authority(app.authority.break_(user, body.reason), user)
