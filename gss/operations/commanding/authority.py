"""Command authority: only one operator can send commands at a time. Authority is taken, released, handed over, or broken with a
reason. Each change is recorded.

A hand-over needs both users: a user requests authority and the holder accepts, or the holder offers it and the named user
accepts. Only one request or offer can wait for an answer at a time.

The holder remains the holder after a restart of the server. ABORT and commands that the server sends on its own behalf
do not need authority.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass

from gss.domain.errors import BadInput, Conflict, NotFound
from gss.operations.accounts.identity import checked_user
from gss.operations.accounts.permissions import permissions_of
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.store import accounts
from gss.store import authority as store
from gss.store.engine import Database
from gss.store.models import Authority

HISTORY = 20
MAX_REASON_LENGTH = 300
REQUEST, OFFER = "request", "offer"
TAKE = "authority.take"
"""Permission to hold authority."""


@dataclass(frozen=True)
class AuthorityState:
    """State of command authority. ``holder``: row of the holder, None if there is no holder. ``history``: latest rows, newest
    first."""

    holder: Authority | None
    history: Sequence[Authority]


class AuthorityService:
    """Controls which operator can send commands."""

    def __init__(self, database: Database, bus: EventBus, now: Now) -> None:
        self._database, self._bus, self._now = database, bus, now
        self._lock = threading.Lock()

    def state(self) -> AuthorityState:
        """Return the holder and the latest entries of the history."""
        with self._database.unit_of_work() as session:
            return AuthorityState(store.holder(session), store.newest(session, HISTORY))

    def holder(self) -> str | None:
        """Return the name of the holder, None if there is no holder."""
        with self._database.unit_of_work() as session:
            row = store.holder(session)
            return row.holder if row else None

    def check(self, user: str) -> None:
        """Raise Conflict with the holder's name if another user holds authority."""
        holder = self.holder()
        if holder is not None and holder != user:
            raise _held_by(holder)

    def require(self, user: str) -> None:
        """Raise Conflict if another user holds authority. If there is no holder, the user takes authority."""
        with self._lock:
            holder = self.holder()
            if holder is None:
                self._take(user)
            elif holder != user:
                raise _held_by(holder)
            else:
                return
        self._record_event("ok", f"{user} took command authority with the first command", user)

    def take(self, user: str) -> AuthorityState:
        """Take authority if there is no holder. Has no effect if the user already holds it. Raises Conflict if another user holds
        it."""
        with self._lock:
            holder = self.holder()
            if holder is not None and holder != user:
                raise _held_by(holder)
            if holder is None:
                self._take(user)
        if holder is None:
            self._record_event("ok", f"{user} took command authority", user)
        return self.state()

    def release(self, user: str) -> AuthorityState:
        """Release authority. Raises Conflict if the user does not hold it."""
        with self._lock, self._database.unit_of_work() as session:
            row = _of_holder(store.holder(session), user, "release")
            store.end(session, row, self._now(), user, "released")
        self._record_event("ok", f"{user} released command authority", user)
        return self.state()

    def request(self, user: str, note: str) -> AuthorityState:
        """Request authority from its holder. Raises Conflict if no other user holds it, or if another request or offer waits for
        an answer."""
        checked_note = _note(note)
        with self._lock, self._database.unit_of_work() as session:
            row = _of_another(store.holder(session), user)
            _check_none_waits(row)
            store.put_transfer(session, row, REQUEST, checked_user(user), checked_note, self._now())
            holder = row.holder
        self._record_event("watch", f"{user} requested command authority from {holder}{_suffix(checked_note)}", user)
        return self.state()

    def offer(self, user: str, to: str, note: str) -> AuthorityState:
        """Offer authority to the user ``to``. Raises Conflict if the caller does not hold authority, or if a request or
        offer waits for an answer. Raises NotFound unless ``to`` is another enabled user whose role has the permission
        to hold authority."""
        checked_note = _note(note)
        with self._lock, self._database.unit_of_work() as session:
            row = _of_holder(store.holder(session), user, "offer")
            _check_none_waits(row)
            other = accounts.user_named(session, to)
            if other is None or not other.enabled or other.name == user or TAKE not in permissions_of(other.role):
                raise NotFound(
                    "command authority cannot be offered to this user",
                    expected="name of another enabled user whose role may take command authority",
                    got=to[:60],
                )
            store.put_transfer(session, row, OFFER, other.name, checked_note, self._now())
            name = other.name
        self._record_event("watch", f"{user} offered command authority to {name}{_suffix(checked_note)}", user)
        return self.state()

    def accept(self, user: str, note: str) -> AuthorityState:
        """Hand authority over by accepting a request (as the holder) or an offer (as the named user). Raises Conflict
        if no request or offer waits for this user's answer."""
        checked_note = _note(note)
        with self._lock, self._database.unit_of_work() as session:
            row = store.holder(session)
            if (
                row is None
                or not row.transfer
                or user != (row.holder if row.transfer == REQUEST else row.transfer_user)
            ):
                raise Conflict("no request or offer of command authority waits for your answer", got=_waiting(row))
            before, after, text = row.holder, row.transfer_user, checked_note or row.transfer_note
            store.end(session, row, self._now(), user, f"handed over to {after}{_suffix(text)}")
            session.flush()
            store.take(session, checked_user(after), self._now())
        self._record_event("ok", f"{before} handed command authority over to {after}{_suffix(text)}", user)
        return self.state()

    def decline(self, user: str, note: str) -> AuthorityState:
        """Refuse or withdraw the request or offer that waits for an answer. Raises Conflict if it does not concern this user."""
        checked_note = _note(note)
        with self._lock, self._database.unit_of_work() as session:
            row = store.holder(session)
            if row is None or not row.transfer or user not in (row.holder, row.transfer_user):
                raise Conflict("no request or offer of command authority concerns you", got=_waiting(row))
            initiator = row.transfer_user if row.transfer == REQUEST else row.holder
            other = row.holder if user == row.transfer_user else row.transfer_user
            owner = "the" if user == initiator else f"{other}'s"
            verb = "withdrew" if user == initiator else "refused"
            kind = row.transfer
            store.put_transfer(session, row, "", "", "", None)
        self._record_event("watch", f"{user} {verb} {owner} {kind} of command authority{_suffix(checked_note)}", user)
        return self.state()

    def break_(self, user: str, reason: str) -> AuthorityState:
        """Take authority from another user, and record the reason. Raises BadInput if the reason is not valid, Conflict
        if no other user holds authority."""
        checked_reason = " ".join(reason.split())
        if not 0 < len(checked_reason) <= MAX_REASON_LENGTH:
            raise BadInput(
                "breaking command authority needs a reason",
                expected=f"1 – {MAX_REASON_LENGTH} characters",
                got=f"{len(checked_reason)}",
            )
        with self._lock, self._database.unit_of_work() as session:
            row = _of_another(store.holder(session), user)
            before = row.holder
            store.end(session, row, self._now(), user, checked_reason)
            session.flush()
            store.take(session, checked_user(user), self._now())
        self._record_event("warning", f"{user} broke the command authority of {before}: {checked_reason}", user)
        return self.state()

    def _take(self, user: str) -> None:
        with self._database.unit_of_work() as session:
            store.take(session, checked_user(user), self._now())

    def _record_event(self, severity: str, text: str, user: str) -> None:
        self._bus.record("authority", severity, text, user=user)
        self._bus.publish("authority", self.state())


def _held_by(holder: str) -> Conflict:
    return Conflict(
        f"command authority is held by {holder}",
        hint="request it from the holder in the header, or break it with a reason",
    )


def _of_another(row: Authority | None, user: str) -> Authority:
    if row is None or row.holder == user:
        raise Conflict(
            "no other user holds command authority",
            got=row.holder if row else "no user",
            hint="take command authority instead",
        )
    return row


def _of_holder(row: Authority | None, user: str, kind: str) -> Authority:
    if row is None or row.holder != user:
        raise Conflict(
            f"only the holder can {kind} command authority", expected=user, got=row.holder if row else "no user"
        )
    return row


def _check_none_waits(row: Authority) -> None:
    if row.transfer:
        raise Conflict(
            f"another {row.transfer} of command authority waits for an answer",
            got=_waiting(row),
            hint="wait until it is answered or withdrawn",
        )


def _waiting(row: Authority | None) -> str:
    if row is None or not row.transfer:
        return "none"
    return f"{row.transfer} by {row.transfer_user}" if row.transfer == REQUEST else f"offer to {row.transfer_user}"


def _note(note: str) -> str:
    checked = " ".join(note.split())
    if len(checked) > MAX_REASON_LENGTH:
        raise BadInput(
            "the note is too long", expected=f"at most {MAX_REASON_LENGTH} characters", got=f"{len(checked)}"
        )
    return checked


def _suffix(note: str) -> str:
    return f": {note}" if note else ""
