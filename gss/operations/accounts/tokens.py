"""API tokens: keys for programs, with a role, an expiry, and a name for the audit log."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from gss.domain.errors import BadInput, Conflict, StoreDown
from gss.operations.accounts.identity import TOKEN_PREFIX, CallerIdentity
from gss.operations.accounts.permissions import checked_role, permissions_of, roles_with
from gss.operations.accounts.secrets import LONGEST, TOKEN_MARK, key_hash, new_token
from gss.operations.accounts.voiding import Voided, Voiding
from gss.operations.clock import CLOCK_AHEAD, Now, iso_z
from gss.store import accounts as store
from gss.store.engine import Database, Transaction
from gss.store.models import ApiToken, User

MAX_NAME_LENGTH = 50
MAX_DAYS = 366
SEEN_EVERY = timedelta(minutes=1)


@dataclass(frozen=True)
class NewToken:
    """A new token. ``key``: returned only once."""

    key: str
    row: ApiToken


@dataclass(frozen=True)
class Revoked:
    """A revoked token, and the users and links that were withdrawn with it."""

    row: ApiToken
    voided: Voided


class TokenService:
    """Creates, checks and revokes tokens. ``changed``: called after each change."""

    def __init__(self, database: Database, now: Now, changed: Callable[[], None]) -> None:
        self._database, self._now, self._changed = database, now, changed

    def list_all(self) -> list[ApiToken]:
        """Return all tokens including revoked ones, newest first."""
        with self._database.unit_of_work() as session:
            return store.tokens(session)

    def add(
        self,
        name: str,
        role: str,
        days: float,
        *,
        by: str,
        owner_id: int | None = None,
        scopes: Sequence[str] = (),
        until: datetime | None = None,
    ) -> NewToken:
        """Create a token. ``scopes``: restrict the permissions of the role. ``owner_id``: user whose account the token depends
        on; None for a token created in the shell. ``until``: latest permitted expiry, which is the expiry of a token that
        creates this one. Raises BadInput or Conflict."""
        granted = permissions_of(checked_role(role))
        if not 0 < len(name) <= MAX_NAME_LENGTH or not name.isprintable() or name.strip() != name:
            raise BadInput("the token name is not valid", expected=f"1 – {MAX_NAME_LENGTH} printable characters")
        if not 0 < days <= MAX_DAYS:
            raise BadInput("invalid token lifetime", expected=f"up to {MAX_DAYS} days", got=f"{days:g}")
        not_granted = sorted(set(scopes) - granted)
        if not_granted:
            names = ", ".join(sorted(granted))
            raise BadInput(
                f"the role {role} does not have all of these permissions",
                expected=f"some of {names}",
                got=", ".join(not_granted)[:200],
                hint="; ".join(f"{name}: {' or '.join(roles_with(name)) or 'no role'}" for name in not_granted[:5]),
            )
        now, key = self._now(), new_token()
        if until is not None and now + timedelta(days=days) > until:
            raise BadInput(
                "a token cannot create a token with a later expiry", expected=f"an expiry before {iso_z(until)}"
            )
        with self._database.unit_of_work() as session:
            if store.living_token(session, name, now) is not None:
                raise Conflict(
                    "a token with this name exists", got=name, hint="choose another name, or revoke the existing token"
                )
            row = ApiToken(
                name=name,
                role=role,
                scopes=sorted(set(scopes)),
                owner_id=owner_id,
                key_hash=key_hash(key),
                created=now,
                created_by=by,
                expires=now + timedelta(days=days),
                revoked=None,
                last_used=None,
            )
            session.add(row)
            session.flush()
        return NewToken(key, row)

    def revoke(self, token_id: int, *, caller_id: int | None = None) -> Revoked:
        """Revoke a token and all tokens created with it. Links created with these tokens become invalid. Users created with them
        are disabled, except the user ``caller_id``."""
        with self._database.unit_of_work() as session:
            row, _ = store.token(session, token_id)
            revoked = self._revoke(session, row, caller_id)
        self._changed()
        return revoked

    def revoke_named(self, name: str) -> Revoked:
        """Revoke the valid token with this name as :meth:`revoke` does. Raises Conflict if there is none."""
        with self._database.unit_of_work() as session:
            token = store.living_token(session, name, self._now())
            if token is None:
                raise Conflict("no active token has this name", got=name[:60])
            revoked = self._revoke(session, token[0], None)
        self._changed()
        return revoked

    def _revoke(self, session: Transaction, row: ApiToken, caller_id: int | None) -> Revoked:
        voiding = Voiding(session, self._now(), caller_id)
        voiding.revoke(row)
        return Revoked(row, voiding.voided)

    def caller_of(self, key: str, *, touch: bool = True) -> CallerIdentity | None:
        """Return the identity of a token, None if the token is not valid. If ``touch`` is False, the time of use is not
        written."""
        if not key.startswith(TOKEN_MARK) or len(key) > LONGEST:
            return None
        now = self._now()
        with self._database.unit_of_work() as session:
            token = store.token_of(session, key_hash(key))
            if token is None or _ended_reason(*token, now):
                return None
        row = token[0]
        if touch and (row.last_used is None or now - row.last_used >= SEEN_EVERY):
            with contextlib.suppress(StoreDown), self._database.unit_of_work() as session:
                store.used(session, row.id, now)
        return _who(row)

    def named(self, name: str) -> CallerIdentity | None:
        """Return the identity of the valid token with this name (without the prefix), None if there is none."""
        now = self._now()
        with self._database.unit_of_work() as session:
            token = store.living_token(session, name, now)
            return None if token is None or _ended_reason(*token, now) else _who(token[0])

    def ended_reason(self, token_id: int) -> str:
        """Return the reason why a token is not valid, "" if it is valid."""
        with self._database.unit_of_work() as session:
            return _ended_reason(*store.token(session, token_id), self._now())


def _ended_reason(row: ApiToken, owner: User | None, now: datetime) -> str:
    if row.revoked is not None:
        return "the token was revoked"
    if now >= row.expires:
        return "the token expired"
    if row.created > now + CLOCK_AHEAD:
        return "the token was created while the server's clock was ahead"
    if owner is not None and not (owner.enabled and owner.role == "admin"):
        return "the creator of the token lost the permission to create it"
    return ""


def _who(row: ApiToken) -> CallerIdentity:
    permissions = permissions_of(row.role, row.scopes)
    return CallerIdentity(
        TOKEN_PREFIX + row.name, row.role, permissions, "token", row.id, row.owner_id, "", row.expires
    )
