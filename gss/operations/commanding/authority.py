"""Command authority: one operator commands at a time. Authority is taken, released, or broken with a reason; each change is
recorded.

It survives a restart of the server: the holder remains the holder. Commands that the server sends on its own behalf are exempt,
and so is ABORT.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass

from gss.domain.errors import BadInput, Conflict
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.store import authority as store
from gss.store.engine import Database
from gss.store.models import Authority

HISTORY = 20
LONGEST_NAME = 60
LONGEST_REASON = 300


@dataclass(frozen=True)
class AuthorityState:
    """The holder's row (None if there is no holder) and previous holders, newest first."""

    holder: Authority | None
    history: Sequence[Authority]


class AuthorityService:
    """Controls which operator may command."""

    def __init__(self, database: Database, bus: EventBus, now: Now) -> None:
        self._database, self._bus, self._now = database, bus, now
        self._lock = threading.Lock()

    def state(self) -> AuthorityState:
        """Return the holder and the newest entries of the history."""
        with self._database.unit_of_work() as session:
            return AuthorityState(store.holder(session), store.newest(session, HISTORY))

    def holder(self) -> str | None:
        """Return the holder's name; None if there is no holder."""
        with self._database.unit_of_work() as session:
            row = store.holder(session)
            return row.holder if row else None

    def check(self, user: str) -> None:
        """Raise Conflict, with the holder's name, if another user holds authority."""
        held = self.holder()
        if held is not None and held != user:
            raise _held_by(held)

    def require(self, user: str) -> None:
        """As ``check``; if there is no holder, the user takes authority by commanding."""
        with self._lock:
            held = self.holder()
            if held is None:
                self._take(user)
            elif held != user:
                raise _held_by(held)
            else:
                return
        self._tell("ok", f"{user} took command authority with the first command", user)

    def take(self, user: str) -> AuthorityState:
        """Take authority if there is no holder; no effect if the user already holds it. Raises Conflict if another user
        holds it."""
        with self._lock:
            held = self.holder()
            if held is not None and held != user:
                raise _held_by(held)
            if held is None:
                self._take(user)
        if held is None:
            self._tell("ok", f"{user} took command authority", user)
        return self.state()

    def release(self, user: str) -> AuthorityState:
        """Release authority. Raises Conflict unless the user holds it."""
        with self._lock, self._database.unit_of_work() as session:
            row = store.holder(session)
            if row is None or row.holder != user:
                raise Conflict(
                    "only the holder can release command authority", expected=user, got=row.holder if row else "nobody"
                )
            store.end(session, row, self._now(), user, "released")
        self._tell("ok", f"{user} released command authority", user)
        return self.state()

    def break_(self, user: str, reason: str) -> AuthorityState:
        """Take authority from another user, with a reason that is recorded. Raises BadInput without a valid reason, Conflict
        if no other user holds it."""
        words = " ".join(reason.split())
        if not 0 < len(words) <= LONGEST_REASON:
            raise BadInput(
                "breaking command authority needs a reason",
                expected=f"1 – {LONGEST_REASON} characters",
                got=f"{len(words)}",
            )
        with self._lock, self._database.unit_of_work() as session:
            row = store.holder(session)
            if row is None or row.holder == user:
                raise Conflict(
                    "nobody else holds command authority", got=row.holder if row else "nobody", hint="take it instead"
                )
            before = row.holder
            store.end(session, row, self._now(), user, words)
            session.flush()
            store.take(session, checked_user(user), self._now())
        self._tell("warning", f"{user} broke the command authority of {before}: {words}", user)
        return self.state()

    def _take(self, user: str) -> None:
        with self._database.unit_of_work() as session:
            store.take(session, checked_user(user), self._now())

    def _tell(self, severity: str, text: str, user: str) -> None:
        self._bus.record("authority", severity, text, user=user)
        self._bus.publish("authority", self.state())


def checked_user(user: str) -> str:
    """Return the user name if it can be shown and stored; raise BadInput otherwise."""
    if not 0 < len(user) <= LONGEST_NAME or not user.isprintable() or user.strip() != user:
        raise BadInput("not a user name", expected=f"1 – {LONGEST_NAME} printable characters", got=repr(user[:80]))
    return user


def _held_by(holder: str) -> Conflict:
    return Conflict(
        f"command authority is held by {holder}", hint="ask for its release, or break it with a reason in the header"
    )
