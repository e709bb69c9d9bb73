"""Identification of the caller of a request, and checks that the identity is still valid."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from datetime import timedelta
from typing import Protocol

from gss.domain.errors import NotFound, StoreDown
from gss.operations.accounts.attempts import BY_TOKEN_ADDRESS, Attempts
from gss.operations.accounts.forward_clock import ForwardClock, time_floor
from gss.operations.accounts.identity import TOKEN_PREFIX, CallerIdentity
from gss.operations.accounts.passwords import Passwords
from gss.operations.accounts.permissions import not_permitted, permissions_of
from gss.operations.accounts.secrets import key_hash
from gss.operations.accounts.sign_in import Lifetimes, SignInService
from gss.operations.accounts.tokens import TokenService
from gss.operations.accounts.users import UserService
from gss.operations.clock import Monotonic, Now
from gss.store.engine import Database

REMEMBERED_S = 1.0
"""Time for which an identity is cached. Changes by this process apply immediately. Changes by other processes apply
after at most this time."""
STORE_DOWN_S = 600.0
"""While the database cannot be read, identities that were verified within this time are accepted, so that ABORT can be sent."""
MAX_REMEMBERED = 1000


class Rules(Protocol):
    """Settings that this module uses."""

    password_passes: int
    password_memory_kib: int
    session_idle_minutes: float
    session_hours: float


def open_account_service(database: Database, rules: Rules, now: Now, monotonic_s: Monotonic) -> AccountService:
    """Create the account service from the settings. Its clock never goes back."""
    passwords = Passwords(rules.password_passes, rules.password_memory_kib)
    lifetimes = Lifetimes(timedelta(minutes=rules.session_idle_minutes), timedelta(hours=rules.session_hours))
    forward = ForwardClock(now, monotonic_s, time_floor(database))
    return AccountService(database, forward, monotonic_s, passwords, lifetimes)


class AccountService:
    """Identifies callers by session or token. ``users``, ``sessions``, ``tokens``: services that manage the rows."""

    def __init__(
        self,
        database: Database,
        now: Now,
        monotonic_s: Monotonic,
        passwords: Passwords,
        lifetimes: Lifetimes | None = None,
    ) -> None:
        self._database, self._monotonic_s = database, monotonic_s
        self.attempts = Attempts(monotonic_s)
        self.passwords = passwords
        self.users = UserService(database, passwords, now, self._forget)
        self.sessions = SignInService(database, passwords, self.attempts, now, lifetimes or Lifetimes(), self._forget)
        self.tokens = TokenService(database, now, self._forget)
        self._remembered: OrderedDict[str, tuple[float, CallerIdentity]] = OrderedDict()
        self._changes = 0
        self._lock = threading.Lock()

    def close(self) -> None:
        """Close the account database. It can be a different database from that of the unit."""
        self._database.close()

    def _forget(self) -> None:
        """Clear the cached identities, because users, sessions or tokens changed."""
        with self._lock:
            self._changes += 1
            self._remembered.clear()

    def session_caller(self, key: str, *, touch: bool = True) -> CallerIdentity | None:
        """Return the owner of a session, None if the session is not valid. If ``touch`` is False, the request does not reset the
        idle timeout and nothing is written."""
        return self._recall(f"session {key_hash(key)}", lambda: self.sessions.caller_of(key, touch=touch))

    def remembered(self, kind: str, key: str, within_s: float = REMEMBERED_S) -> CallerIdentity | None:
        """Return an identity that was read within this time, without a database query; None if there is none. ``kind``: session or
        token."""
        with self._lock:
            at_s, cached = self._remembered.get(f"{kind} {key_hash(key)}", (0.0, None))
            return cached if self._monotonic_s() - at_s < within_s else None

    def token_caller(self, key: str, address: str, *, touch: bool = True) -> CallerIdentity | None:
        """Return the identity of a token, None if the token is not valid. Raises RateLimited after too many invalid tokens from
        this address. If ``touch`` is False, nothing is written."""
        hashed = f"token {key_hash(key)}"
        caller = self._recall(hashed, lambda: self.tokens.caller_of(key, touch=touch))
        if caller is None:
            self.attempts.begin([(f"token {address}", BY_TOKEN_ADDRESS)])
        return caller

    def ended_reason(self, caller: CallerIdentity) -> str:
        """Return the reason why a session or token is no longer valid, "" if it is valid. Long-lived connections call this every
        few seconds."""
        try:
            reason = (
                self.sessions.ended_reason(caller.key_id)
                if caller.kind == "session"
                else self.tokens.ended_reason(caller.key_id)
            )
        except NotFound:
            return "it was removed"
        return reason

    def require(self, name: str, permission: str) -> None:
        """Raise NotPermitted if the user or token with this name does not have the permission now. Work that continues
        after its HTTP request uses this check."""
        role, permissions = self._permissions(name)
        if permission not in permissions:
            raise not_permitted(permission, role)

    def _permissions(self, name: str) -> tuple[str, frozenset[str]]:
        if name.startswith(TOKEN_PREFIX):
            token = self.tokens.named(name.removeprefix(TOKEN_PREFIX))
            return ("", frozenset()) if token is None else (token.role, token.permissions)
        user = self.users.named(name)
        if user is None or not user.enabled:
            return "", frozenset()
        return user.role, permissions_of(user.role)

    def _recall(self, hashed: str, find: Callable[[], CallerIdentity | None]) -> CallerIdentity | None:
        with self._lock:
            at_s, cached = self._remembered.get(hashed, (0.0, None))
            if cached is not None and self._monotonic_s() - at_s < REMEMBERED_S:
                return cached
            changes = self._changes
        read_s = self._monotonic_s()
        try:
            caller = find()
        except StoreDown:
            if cached is not None and read_s - at_s < STORE_DOWN_S:
                return cached
            raise
        with self._lock:
            self._remembered.pop(hashed, None)
            # If accounts changed meanwhile, this identity can be outdated.
            if caller is not None and changes == self._changes:
                self._remembered[hashed] = (read_s, caller)
            while len(self._remembered) > MAX_REMEMBERED:
                self._remembered.popitem(last=False)
        return caller
