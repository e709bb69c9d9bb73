"""Users, sessions, tokens, the audit record."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc

Role = Literal["viewer", "operator", "catalogue manager", "engineer", "admin"]
Password = Field(min_length=1, max_length=400, json_schema_extra={"format": "password"})
Key = Field(min_length=1, max_length=200)


class SessionOut(Out):
    """Who is signed in with this browser or token. ``csrf`` goes into the header X-GSS of every change. ``expires``: when the
    session ends if nothing is asked until then."""

    signed_in: bool
    name: str = ""
    role: str = ""
    permissions: list[str] = Field(default=[])
    csrf: str = ""
    expires: Utc | None = None
    set_up_needed: bool = False


class SignInBody(In):
    """Name and password."""

    name: str = Field(max_length=60)
    password: str = Password


class PasswordBody(In):
    """Another password for oneself."""

    old: str = Password
    new: str = Password


class SetUpBody(In):
    """The first admin, by the link that the server printed."""

    token: str = Key
    name: str = Field(min_length=1, max_length=60)
    password: str = Password


class LinkCheckBody(In):
    """A one-time link that somebody opened."""

    kind: Literal["setup", "password"]
    token: str = Key


class PasswordLinkBody(In):
    """A password by a one-time link."""

    token: str = Key
    password: str = Password


class UserOut(Out):
    """Somebody."""

    id: int
    name: str
    role: str
    enabled: bool
    has_password: bool
    created: Utc
    created_by: str
    last_sign_in: Utc | None


class UserIn(In):
    """A new user."""

    name: str = Field(min_length=1, max_length=60)
    role: Role


class UserChangeIn(In):
    """Another role, on or off; what is not given stays."""

    role: Role | None = None
    enabled: bool | None = None


class LinkedUserOut(Out):
    """A user with a one-time link, relative to this server, that is shown once: hand it over."""

    user: UserOut
    link: str
    expires: Utc


class SignInOut(Out):
    """One session. ``own``: the one that asks."""

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
    """A program's key, without the key."""

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
    """A new token. ``scopes``: permissions of the role that it keeps; none keeps all."""

    name: str = Field(min_length=1, max_length=50)
    role: Role
    days: float = Field(gt=0, le=366)
    scopes: list[str] = Field(default=[], max_length=60)


class NewTokenOut(Out):
    """A token with its key, which is shown once."""

    token: TokenOut
    key: str


class AuditRowOut(Out):
    """One line of the record."""

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
    """Whether the record is whole; ``last_hash`` is worth noting elsewhere."""

    rows: int
    last_hash: str
    problem: str
