"""Users, sessions, tokens and the audit log."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc
from gss.operations.requests import MAX_PATH_LENGTH

Role = Literal["viewer", "operator", "catalogue manager", "engineer", "admin"]
Password = Field(min_length=1, max_length=400, json_schema_extra={"format": "password"})
Key = Field(min_length=1, max_length=200)


class SessionOut(Out):
    """Caller of this session or token. ``csrf``: required value of the header X-GSS in every change. ``expires``: end
    of the session if no further request is received. ``several_units``: true if the server has named units; see
    /api/fleet. ``start_page``: page that the user chose to open after sign-in, "" if none was chosen;
    ``role_start_page``: page for this role."""

    signed_in: bool
    name: str = ""
    role: str = ""
    permissions: list[str] = Field(default=[])
    csrf: str = ""
    expires: Utc | None = None
    set_up_needed: bool = False
    several_units: bool = False
    start_page: str = ""
    role_start_page: str = ""


class SignInBody(In):
    """User name and password."""

    name: str = Field(max_length=60)
    password: str = Password


class StartPageBody(In):
    """Page that opens after sign-in, within the unit and with its query; "" for the start page of the role."""

    path: str = Field(max_length=MAX_PATH_LENGTH)


class PasswordBody(In):
    """Change of the caller's password."""

    old: str = Password
    new: str = Password


class SetUpBody(In):
    """First admin, created with the link that the server printed."""

    token: str = Key
    name: str = Field(min_length=1, max_length=60)
    password: str = Password


class LinkCheckBody(In):
    """One-time link to check."""

    kind: Literal["setup", "password"]
    token: str = Key


class PasswordLinkBody(In):
    """New password, set with a one-time link."""

    token: str = Key
    password: str = Password


class UserOut(Out):
    """User account. ``disabled_reason``: why the account was disabled automatically; "" otherwise."""

    id: int
    name: str
    role: str
    enabled: bool
    has_password: bool
    created: Utc
    created_by: str
    last_sign_in: Utc | None
    disabled_reason: str


class UserIn(In):
    """New user."""

    name: str = Field(min_length=1, max_length=60)
    role: Role


class UserChangeIn(In):
    """Changed role or state of a user; null leaves a value unchanged. ``keep_created``: true if users and links that a
    demoted or disabled admin created stay valid."""

    role: Role | None = None
    enabled: bool | None = None
    keep_created: bool = False


class LinkedUserOut(Out):
    """User with a one-time password link, relative to this server. The link is shown only once; pass it to the user."""

    user: UserOut
    link: str
    expires: Utc


class SignInOut(Out):
    """Open session. ``own``: true for the session that sent this request."""

    id: int
    name: str
    role: str
    created: Utc
    last_seen: Utc
    expires: Utc
    address: str
    agent: str
    own: bool


class TokenOut(Out):
    """API token, without its key."""

    id: int
    name: str
    role: str
    scopes: list[str]
    created: Utc
    created_by: str
    expires: Utc
    revoked: Utc | None
    last_used: Utc | None


class TokenIn(In):
    """New API token. ``scopes``: subset of the role's permissions that the token has; empty: all permissions of the
    role."""

    name: str = Field(min_length=1, max_length=50)
    role: Role
    days: float = Field(gt=0, le=366)
    scopes: list[str] = Field(default=[], max_length=60)


class NewTokenOut(Out):
    """New API token with its key, which is shown only once."""

    token: TokenOut
    key: str


class AuditRowOut(Out):
    """Row of the audit log."""

    seq: int
    at: Utc
    who: str
    role: str
    action: str
    target: str
    result: str
    detail: str
    address: str
    previous: str
    hash: str


class AuditVerdictOut(Out):
    """Result of the audit log verification. ``problem``: empty if the log is intact. ``anchors``: result of the
    comparison with the anchor file. ``last_hash``: hash of the last row, to be stored elsewhere for a later check."""

    rows: int
    last_hash: str
    problem: str
    anchors: str
