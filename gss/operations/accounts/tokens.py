"""Tokens: keys for programs, with a role, an expiry, and a name for the audit log."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from gss.domain.errors import BadInput, Conflict, StoreDown
from gss.operations.accounts.identity import TOKEN_PREFIX, Who
from gss.operations.accounts.permissions import checked_role, permissions_of, roles_with
from gss.operations.accounts.secrets import LONGEST, TOKEN_MARK, key_hash, new_token
from gss.operations.clock import Now, iso_z
from gss.store import accounts as store
from gss.store.engine import Database
from gss.store.models import ApiToken, User

LONGEST_NAME = 50
LONGEST_DAYS = 366
SEEN_EVERY = timedelta(minutes=1)


@dataclass(frozen=True)
class NewToken:
    """A token's key, which is returned only once, and its row."""

    key: str
    row: ApiToken


class TokenService:
    """Creates, checks and revokes tokens. ``changed`` is called after each change."""

    def __init__(self, database: Database, now: Now, changed: Callable[[], None]) -> None:
        self._database, self._now, self._changed = database, now, changed

    def every(self) -> list[ApiToken]:
        """Return all tokens, newest first, including revoked ones."""
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
        """Create a token. ``scopes`` narrow the role. It becomes invalid with its owner's account; a token made in the shell
        has no owner. ``until``: expiry of the token that creates it, which it may not exceed. Raises BadInput or Conflict."""
        granted = permissions_of(checked_role(role))
        if not 0 < len(name) <= LONGEST_NAME or not name.isprintable() or name.strip() != name:
            raise BadInput("a token needs a name", expected=f"1 – {LONGEST_NAME} printable characters")
        if not 0 < days <= LONGEST_DAYS:
            raise BadInput("a token has an end", expected=f"up to {LONGEST_DAYS} days", got=f"{days:g}")
        strange = sorted(set(scopes) - granted)
        if strange:
            had = ", ".join(sorted(granted))
            raise BadInput(
                f"the role {role} has not all of these permissions",
                expected=f"some of {had}",
                got=", ".join(strange)[:200],
                hint="; ".join(f"{word}: {' or '.join(roles_with(word)) or 'no role has it'}" for word in strange[:5]),
            )
        now, key = self._now(), new_token()
        if until is not None and now + timedelta(days=days) > until:
            raise BadInput("a token makes none that outlives it", expected=f"an end before {iso_z(until)}")
        with self._database.unit_of_work() as session:
            if store.living_token(session, name, now) is not None:
                raise Conflict("another token has this name", got=name, hint="take another name, or revoke that one")
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

    def revoke(self, token_id: int) -> ApiToken:
        """Revoke a token and all tokens created with it."""
        with self._database.unit_of_work() as session:
            row, _ = store.token(session, token_id)
            self._revoke(session, row)
        self._changed()
        return row

    def revoke_named(self, name: str) -> ApiToken:
        """Revoke the valid token of that name. Raises Conflict if there is none."""
        with self._database.unit_of_work() as session:
            found = store.living_token(session, name, self._now())
            if found is None:
                raise Conflict("no living token has this name", got=name[:60])
            self._revoke(session, found[0])
        self._changed()
        return found[0]

    def _revoke(self, session: Any, row: ApiToken) -> None:
        """Revoke a token and its children. A name can be reused, so only tokens created during this one's lifetime are its
        children."""
        row.revoked = row.revoked or self._now()
        for child in store.tokens_made_by(session, TOKEN_PREFIX + row.name, row.created, row.revoked):
            self._revoke(session, child)

    def who(self, key: str, *, touch: bool = True) -> Who | None:
        """Return the identity of the token, or None if it is not valid. Without ``touch`` its time of use is not written."""
        if not key.startswith(TOKEN_MARK) or len(key) > LONGEST:
            return None
        now = self._now()
        with self._database.unit_of_work() as session:
            found = store.token_of(session, key_hash(key))
            if found is None or _why_over(*found, now):
                return None
        row = found[0]
        if touch and (row.last_used is None or now - row.last_used >= SEEN_EVERY):
            with contextlib.suppress(StoreDown), self._database.unit_of_work() as session:
                store.used(session, row.id, now)
        return _who(row)

    def named(self, name: str) -> Who | None:
        """Return the identity of the valid token of that name (without the prefix)."""
        now = self._now()
        with self._database.unit_of_work() as session:
            found = store.living_token(session, name, now)
            return None if found is None or _why_over(*found, now) else _who(found[0])

    def why_over(self, token_id: int) -> str:
        """Return why a token is invalid; "" while it is valid."""
        with self._database.unit_of_work() as session:
            return _why_over(*store.token(session, token_id), self._now())


def _why_over(row: ApiToken, owner: User | None, now: datetime) -> str:
    if row.revoked is not None:
        return "the token was revoked"
    if now >= row.expires:
        return "the token's time is over"
    if owner is not None and not (owner.enabled and owner.role == "admin"):
        return "who made the token may not do so any more"
    return ""


def _who(row: ApiToken) -> Who:
    permissions = permissions_of(row.role, row.scopes)
    return Who(TOKEN_PREFIX + row.name, row.role, permissions, "token", row.id, row.owner_id, "", row.expires)
