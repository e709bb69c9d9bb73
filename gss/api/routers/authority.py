"""Command authority: read, take, release, request, offer, accept, decline, break."""

from __future__ import annotations

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import App, AuditNote, User, need
from gss.api.schemas.authority import AuthorityNoteIn, AuthorityOfferIn, AuthorityOut, BreakIn

router = api_router("authority")


@router.get("/authority")
def read_authority(app: App, user: User) -> AuthorityOut:
    """Current and past holders of command authority."""
    return present.authority.authority(app.commanding.authority.state(), user)


@router.post("/authority/take", dependencies=[need("authority.take")])
def take_authority(app: App, user: User) -> AuthorityOut:
    """Take command authority if no user holds it."""
    return present.authority.authority(app.commanding.authority.take(user), user)


@router.post("/authority/release", dependencies=[need("authority.take")])
def release_authority(app: App, user: User) -> AuthorityOut:
    """Release command authority."""
    return present.authority.authority(app.commanding.authority.release(user), user)


@router.post("/authority/request", dependencies=[need("authority.take")])
def request_authority(app: App, user: User, body: AuthorityNoteIn, audit_note: AuditNote) -> AuthorityOut:
    """Request command authority from its holder."""
    audit_note(f"from {app.commanding.authority.holder() or 'no user'}, {body.note}")
    return present.authority.authority(app.commanding.authority.request(user, body.note), user)


@router.post("/authority/offer", dependencies=[need("authority.take")])
def offer_authority(app: App, user: User, body: AuthorityOfferIn, audit_note: AuditNote) -> AuthorityOut:
    """Offer command authority to another user."""
    audit_note(f"to {body.user}, {body.note}")
    return present.authority.authority(app.commanding.authority.offer(user, body.user, body.note), user)


@router.post("/authority/accept", dependencies=[need("authority.take")])
def accept_authority(app: App, user: User, body: AuthorityNoteIn, audit_note: AuditNote) -> AuthorityOut:
    """Transfer command authority: the holder accepts a request, or the named user accepts an offer."""
    audit_note(f"of {app.commanding.authority.holder() or 'no user'}, {body.note}")
    return present.authority.authority(app.commanding.authority.accept(user, body.note), user)


@router.post("/authority/decline", dependencies=[need("authority.take")])
def decline_authority(app: App, user: User, body: AuthorityNoteIn, audit_note: AuditNote) -> AuthorityOut:
    """Decline or withdraw the pending request or offer of command authority."""
    audit_note(f"of {app.commanding.authority.holder() or 'no user'}, {body.note}")
    return present.authority.authority(app.commanding.authority.decline(user, body.note), user)


@router.post("/authority/break", dependencies=[need("authority.break")])
def break_authority(app: App, user: User, body: BreakIn, audit_note: AuditNote) -> AuthorityOut:
    """Take command authority from its holder, with a reason."""
    audit_note(f"of {app.commanding.authority.holder() or 'no user'}, {body.reason}")
    return present.authority.authority(app.commanding.authority.break_(user, body.reason), user)
