"""Command authority: read, take, release, break."""

from __future__ import annotations

from fastapi import APIRouter

from gss.api import present
from gss.api.deps import App, Deed, User, need
from gss.api.schemas.authority import AuthorityOut, BreakIn

router = APIRouter(tags=["authority"])


@router.get("/authority")
def read_authority(app: App, user: User) -> AuthorityOut:
    """Current and past holders of command authority."""
    return present.authority.authority(app.authority.state(), user)


@router.post("/authority/take", dependencies=[need("authority.take")])
def take_authority(app: App, user: User) -> AuthorityOut:
    """Take command authority while no user holds it."""
    return present.authority.authority(app.authority.take(user), user)


@router.post("/authority/release", dependencies=[need("authority.take")])
def release_authority(app: App, user: User) -> AuthorityOut:
    """Release command authority."""
    return present.authority.authority(app.authority.release(user), user)


@router.post("/authority/break", dependencies=[need("authority.break")])
def break_authority(app: App, user: User, body: BreakIn, deed: Deed) -> AuthorityOut:
    """Take command authority from its holder, with a reason."""
    deed(f"of {app.authority.holder() or 'nobody'}, {body.reason}")
    return present.authority.authority(app.authority.break_(user, body.reason), user)
