"""Users and their sessions, for admins."""

from __future__ import annotations

from gss.api.api_router import api_router
from gss.api.deps import App, AuditNote, CurrentUser, RowId, User, need
from gss.api.schemas.accounts import LinkedUserOut, SignInOut, UserChangeIn, UserIn, UserOut
from gss.operations.accounts.users import Link
from gss.store import models

router = api_router("users")
ADMIN = need("admin.users")


@router.get("/users", dependencies=[ADMIN])
def list_users(app: App) -> list[UserOut]:
    """Users, by name."""
    return [_user(row) for row in app.accounts.accounts.users.list_all()]


@router.post("/users", status_code=201, dependencies=[ADMIN])
def add_user(app: App, caller: CurrentUser, body: UserIn, audit_note: AuditNote) -> LinkedUserOut:
    """Create a user. Returns the one-time link to set the password."""
    audit_note(f"{body.name} as {body.role}")
    caller.require_all(body.role, ())
    row = app.accounts.accounts.users.add(body.name, body.role, by=caller.name)
    return _linked(row, app.accounts.accounts.users.password_link(row.id, caller.handed_out_until, by=caller.name))


@router.put("/users/{user_id}", dependencies=[ADMIN])
def change_user(app: App, user_id: RowId, caller: CurrentUser, body: UserChangeIn, audit_note: AuditNote) -> UserOut:
    """Change a user's role, or enable or disable the user. The change applies from the next request. Disabling a user
    ends all sessions of the user. If an admin is demoted or disabled, the users that this admin created are disabled
    too, unless ``keep_created`` is true."""
    previous = app.accounts.accounts.users.get(user_id)
    changes = (
        previous.name,
        f"from {previous.role} to {body.role}" if body.role else "",
        "" if body.enabled is None else "activated" if body.enabled else "deactivated",
        "created users kept" if body.keep_created else "",
    )
    audit_note(*changes)
    caller.require_all(previous.role, ())
    caller.require_all(body.role or previous.role, ())
    changed = app.accounts.accounts.users.change(
        user_id, role=body.role, enabled=body.enabled, keep_created=body.keep_created, caller_id=caller.user_id
    )
    audit_note(*changes, changed.voided)
    return _user(changed.user)


@router.post("/users/{user_id}/link", status_code=201, dependencies=[ADMIN])
def new_password_link(app: App, user_id: RowId, caller: CurrentUser, audit_note: AuditNote) -> LinkedUserOut:
    """Create a new one-time password link for a user. Earlier links become invalid."""
    user = app.accounts.accounts.users.get(user_id)
    audit_note(user.name)
    caller.require_all(user.role, ())
    link = app.accounts.accounts.users.password_link(user_id, caller.handed_out_until, by=caller.name)
    return _linked(app.accounts.accounts.users.get(user_id), link)


@router.get("/sessions", dependencies=[ADMIN])
def list_sessions(app: App, caller: CurrentUser) -> list[SignInOut]:
    """Open sessions, most recently used first."""
    return [
        SignInOut(
            id=row.id,
            name=user.name,
            role=user.role,
            created=row.created,
            last_seen=row.last_seen,
            expires=row.expires,
            address=row.address,
            agent=row.agent,
            own=caller.kind == "session" and caller.key_id == row.id,
        )
        for row, user in app.accounts.accounts.sessions.active()
    ]


@router.delete("/sessions/{session_id}", status_code=204, dependencies=[ADMIN])
def end_session(app: App, user: User, session_id: RowId) -> None:
    """End a user's session."""
    app.accounts.accounts.sessions.end(session_id, by=user)


def _user(row: models.User) -> UserOut:
    names = ("id", "name", "role", "enabled", "created", "created_by", "last_sign_in", "disabled_reason")
    return UserOut(**{name: getattr(row, name) for name in names}, has_password=bool(row.password_hash))


def _linked(row: models.User, link: Link) -> LinkedUserOut:
    return LinkedUserOut(user=_user(row), link=f"/welcome#{link.key}", expires=link.expires)
