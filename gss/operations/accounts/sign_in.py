"""Signing in and out. Sessions are stored in the database with the hash of a random key. The browser stores the key in a
cookie."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta

from gss.domain.errors import NotPermitted, NotSignedIn, StoreDown
from gss.operations.accounts.attempts import BY_ADDRESS, BY_NAME, Attempts, Brake
from gss.operations.accounts.identity import CallerIdentity
from gss.operations.accounts.passwords import Passwords
from gss.operations.accounts.permissions import permissions_of
from gss.operations.accounts.secrets import csrf_of, key_hash, new_key
from gss.operations.clock import CLOCK_AHEAD, Now
from gss.store import accounts as store
from gss.store.engine import Database
from gss.store.models import SignIn, User

SEEN_EVERY = timedelta(minutes=1)
"""Minimum interval between updates of ``last_seen``."""
DEVICE_LASTS = timedelta(days=90)
"""Failed attempts by others do not delay a user who signed in with the same browser within this time."""


@dataclass(frozen=True)
class Lifetimes:
    """Lifetimes of a session: it ends after ``idle`` without a request, and in any case after ``longest``."""

    idle: timedelta = timedelta(hours=8)
    longest: timedelta = timedelta(hours=24)


@dataclass(frozen=True)
class NewSession:
    """A new session. ``key``: session key for the cookie, which is returned only once. ``device``: value of the cookie that
    identifies this browser at the next sign-in."""

    key: str
    caller: CallerIdentity
    device: str


class SignInService:
    """Starts, reads and ends sessions. ``changed``: called after each change."""

    def __init__(
        self,
        database: Database,
        passwords: Passwords,
        attempts: Attempts,
        now: Now,
        lifetimes: Lifetimes,
        changed: Callable[[], None],
    ) -> None:
        self._database, self._passwords, self._attempts, self._now = database, passwords, attempts, now
        self._lifetimes, self._changed = lifetimes, changed

    def sign_in(
        self, name: str, password: str, *, address: str, agent: str = "", old_key: str = "", device: str = ""
    ) -> NewSession:
        """Authenticate a user and start a session. ``old_key``: key of the browser's previous session, which is ended
        to prevent session fixation. ``device``: device cookie of the browser. Raises RateLimited during a wait, and
        NotSignedIn, which does not reveal whether the name or the password was wrong."""
        row = self._named(name)
        keys = self._brakes(name, row, address, device)
        self._attempts.begin(keys)
        is_correct = self._passwords.verify(row.password_hash if row and row.enabled else "", password)
        if row is None or not row.enabled or not is_correct:
            raise _wrong()
        self._attempts.passed(keys)
        self._attempts.forget(_name_key(name))
        verified_hash = row.password_hash
        if self._passwords.outdated(verified_hash):
            verified_hash = self._rehash(row, password)
        if old_key:
            self.sign_out(old_key)
        return self._begin(row.id, verified_hash, address, agent)

    def check_password(self, caller: CallerIdentity, password: str) -> str:
        """Return the hash of the caller's password. Raises NotPermitted if it has another one. The number of attempts is limited
        per user."""
        row = self._named(caller.name)
        keys = [(f"own password of {caller.user_id}", BY_NAME)]
        self._attempts.begin(keys)
        if not self._passwords.verify(row.password_hash if row else "", password) or row is None:
            raise NotPermitted("wrong current password", hint="try again, or ask an admin for a password link")
        self._attempts.passed(keys)
        return row.password_hash

    def begin(self, user: User, *, address: str, agent: str = "") -> NewSession:
        """Start a session with a new key for a user who has just set this password. Raises NotSignedIn if the password
        has been changed since, or the user was disabled."""
        return self._begin(user.id, user.password_hash, address, agent)

    def _begin(self, user_id: int, verified_hash: str, address: str, agent: str) -> NewSession:
        now, key, device = self._now(), new_key(), new_key()
        with self._database.unit_of_work() as session:
            # A change of the password ends the sessions that are stored at that time. It can happen while a hash is
            # computed, and must also prevent this session.
            user = store.record_sign_in(session, user_id, verified_hash, now)
            if user is None:
                raise _wrong()
            row = SignIn(
                user_id=user.id,
                key_hash=key_hash(key),
                created=now,
                last_seen=now,
                expires=now + self._lifetimes.longest,
                ended=None,
                end_reason="",
                address=address[:60],
                agent="".join(c for c in agent if c.isprintable())[:200],
                device_hash=key_hash(device),
            )
            session.add(row)
            session.flush()
            return NewSession(key, self._who(row, user, key), device)

    def sign_out(self, key: str) -> None:
        """End the session with this key if it exists."""
        with self._database.unit_of_work() as session:
            sign_in = store.sign_in_of(session, key_hash(key))
            if sign_in is not None and sign_in[0].ended is None:
                sign_in[0].ended, sign_in[0].end_reason = self._now(), "signed out"
        self._changed()

    def end(self, sign_in_id: int, *, by: str) -> None:
        """End a user's session."""
        with self._database.unit_of_work() as session:
            row, _ = store.sign_in(session, sign_in_id)
            if row.ended is None:
                row.ended, row.end_reason = self._now(), f"ended by {by}"[:60]
        self._changed()

    def active(self) -> list[tuple[SignIn, User]]:
        """Return the valid sessions with their users."""
        now = self._now()
        with self._database.unit_of_work() as session:
            return [(s, u) for s, u in store.open_sign_ins(session, now) if not self._ended_reason(s, u, now)]

    def caller_of(self, key: str, *, touch: bool = True) -> CallerIdentity | None:
        """Return the user of a session, None if the session has ended or never existed. If ``touch`` is True, the call counts as
        a request."""
        now = self._now()
        with self._database.unit_of_work() as session:
            sign_in = store.sign_in_of(session, key_hash(key))
            if sign_in is None or self._ended_reason(*sign_in, now):
                return None
        row, user = sign_in
        if touch and now - row.last_seen >= SEEN_EVERY:
            row.last_seen = now
            with contextlib.suppress(StoreDown), self._database.unit_of_work() as session:
                store.seen(session, row.id, now)  # a full disk must not lock users out
        return self._who(row, user, key)

    def ended_reason(self, sign_in_id: int) -> str:
        """Return the reason why a session has ended, "" if it is valid."""
        with self._database.unit_of_work() as session:
            return self._ended_reason(*store.sign_in(session, sign_in_id), self._now())

    def _ended_reason(self, row: SignIn, user: User, now: datetime) -> str:
        if row.ended is not None:
            return row.end_reason or "ended"
        if not user.enabled:
            return "the user was deactivated"
        if now >= row.expires:
            return "session lifetime exceeded"
        if row.created > now + CLOCK_AHEAD:
            return "signed in while the server's clock was ahead"
        return "no request within the idle timeout" if now - row.last_seen >= self._lifetimes.idle else ""

    def _named(self, name: str) -> User | None:
        with self._database.unit_of_work() as session:
            return store.user_named(session, name)

    def _brakes(self, name: str, row: User | None, address: str, device: str) -> list[tuple[str, Brake]]:
        """Return the rate-limit keys of an attempt: address and name, or only the device if this user has signed in with it.
        Without this exception, failed attempts by others under the same name or from the same address could lock out the only
        admin. The keys of all other attempts do not depend on whether the name exists or was used from this address."""
        if device:
            hashed = key_hash(device)
            with self._database.unit_of_work() as session:
                known_id = store.user_of_device(session, hashed, self._now() - DEVICE_LASTS)
            if row is not None and known_id == row.id:
                return [(f"device {hashed}", BY_NAME)]
        return [(f"address {address}", BY_ADDRESS), (_name_key(name), BY_NAME)]

    def _rehash(self, row: User, password: str) -> str:
        """Replace the hash of a verified password by one with the current cost parameters. Return the stored hash.
        Raises NotSignedIn if the password has been changed since."""
        hashed = self._passwords.hash(password)
        with self._database.unit_of_work() as session:
            if store.replace_hash(session, row.id, row.password_hash, hashed):
                return hashed
            stored_hash = store.user(session, row.id).password_hash
        # Another sign-in of the same user can have replaced the hash.
        if not self._passwords.verify(stored_hash, password):
            raise _wrong()
        return stored_hash

    def _who(self, row: SignIn, user: User, key: str) -> CallerIdentity:
        ends = min(row.expires, row.last_seen + self._lifetimes.idle)
        return CallerIdentity(
            user.name,
            user.role,
            permissions_of(user.role),
            "session",
            row.id,
            user.id,
            csrf_of(key),
            ends,
            user.start_page,
        )


def _wrong() -> NotSignedIn:
    return NotSignedIn("wrong name or password", hint="try again, or ask an admin for a password link")


def _name_key(name: str) -> str:
    return f"name {store.name_key(name)}"
