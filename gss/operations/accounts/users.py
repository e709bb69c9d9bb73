"""Users and the one-time links for setting a password."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from gss.domain.errors import BadInput, Conflict, NotPermitted
from gss.operations.accounts.identity import TOKEN_PREFIX, checked_user
from gss.operations.accounts.look_alikes import check_script, check_unlike
from gss.operations.accounts.passwords import Passwords
from gss.operations.accounts.permissions import checked_role
from gss.operations.accounts.secrets import key_hash, new_key
from gss.operations.accounts.voiding import PASSWORD, Voided, Voiding
from gss.operations.clock import Now
from gss.operations.requests import check_page_path
from gss.store import accounts as store
from gss.store.engine import Database
from gss.store.models import OneTimeLink, User

SETUP = "setup"
SETUP_LASTS = timedelta(hours=1)
PASSWORD_LASTS = timedelta(hours=24)
OF_SOFTWARE = ("gss", "server", "system", "nobody", "shell", "unknown", "unknown name", "set-up link")
BEGIN_OF_SOFTWARE = (TOKEN_PREFIX, "shell:")
"""Names reserved for software and unknown users in the audit log."""
UNSEEN = frozenset("\u034f\u115f\u1160\u17b4\u17b5\u2800\u3164\uffa0")
"""Invisible letters and marks."""
VARIATION = ("VARIATION SELECTOR", "MONGOLIAN FREE VARIATION SELECTOR")


@dataclass(frozen=True)
class Link:
    """A one-time link. ``key``: returned only once."""

    key: str
    expires: datetime


@dataclass(frozen=True)
class Changed:
    """A changed user, and the users and links that were withdrawn with the change."""

    user: User
    voided: Voided


class UserService:
    """Creates and changes users, and creates one-time links. ``changed``: called after each change."""

    def __init__(self, database: Database, passwords: Passwords, now: Now, changed: Callable[[], None]) -> None:
        self._database, self._passwords, self._now, self._changed = database, passwords, now, changed

    # --- queries ------------------------------------------------------------------------------------------------

    def list_all(self) -> list[User]:
        """Return all users, sorted by name."""
        with self._database.unit_of_work() as session:
            return store.users(session)

    def get(self, user_id: int) -> User:
        """Return the user with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.user(session, user_id)

    def named(self, name: str) -> User | None:
        """Return the user with this name, None if there is none."""
        with self._database.unit_of_work() as session:
            return store.user_named(session, name)

    def set_up_needed(self) -> bool:
        """True if no user exists."""
        with self._database.unit_of_work() as session:
            return not store.any_user(session)

    # --- creation -----------------------------------------------------------------------------------------------

    def add(self, name: str, role: str, *, by: str, password: str = "") -> User:
        """Create a user. Without a password, the user needs a link to set one before the first sign-in. Raises BadInput for an
        unacceptable name, role or password, Conflict if the name is already used or looks like another user's name."""
        checked_role(role)
        hashed = self._hashed(password, name) if password else ""
        with self._database.unit_of_work() as session:
            return self._add(session, name, role, hashed, by)

    def set_up(self, key: str, name: str, password: str) -> User:
        """Create the first admin with the link that the server printed at its start. Raises NotPermitted if the link is not
        valid."""
        checked_name(name)
        self._fresh(SETUP, key)
        hashed = self._hashed(password, name)
        with self._database.unit_of_work() as session:
            if store.take_link(session, SETUP, key_hash(key), self._now()) is None or store.any_user(session):
                raise _used_link()
            return self._add(session, name, "admin", hashed, "set-up link")

    def _add(self, session: Any, name: str, role: str, hashed: str, by: str) -> User:
        now, name = self._now(), checked_name(name)
        check_unlike(name, [row.name for row in store.users(session)])
        row = User(
            name=name,
            role=role,
            enabled=True,
            password_hash=hashed,
            created=now,
            created_by=by,
            password_changed=now if hashed else None,
            last_sign_in=None,
            disabled_reason="",
        )
        return store.add_user(session, row)

    def _hashed(self, password: str, name: str) -> str:
        self._passwords.check_new(password, name)
        return self._passwords.hash(password)

    # --- changes ------------------------------------------------------------------------------------------------

    def change(
        self,
        user_id: int,
        *,
        role: str | None = None,
        enabled: bool | None = None,
        keep_created: bool = False,
        caller_id: int | None = None,
    ) -> Changed:
        """Change the role or the enabled state of a user. Disabling a user ends all sessions of the user. If an admin
        is demoted or disabled, the unused links that this admin created become invalid, and the users that this admin
        created are disabled, except the user ``caller_id``. ``keep_created``: True to keep these links and users.
        Raises Conflict for the last enabled admin."""
        if role is not None:
            checked_role(role)
        with self._database.unit_of_work() as session:
            row = store.user(session, user_id)
            was_admin = row.role == "admin" and row.enabled
            row.role = row.role if role is None else role
            row.enabled = row.enabled if enabled is None else enabled
            row.disabled_reason = "" if row.enabled else row.disabled_reason
            session.flush()
            voiding = Voiding(session, self._now(), caller_id)
            if not row.enabled:
                voiding.disable(row, row.disabled_reason)
            if was_admin and not (row.enabled and row.role == "admin") and not keep_created:
                voiding.withdraw(row, "is no longer an admin" if row.enabled else "was disabled")
            if was_admin and store.enabled_admins(session) == 0:
                raise Conflict(
                    "the last admin must keep the role",
                    hint="make another user an admin first; users that this admin created are disabled too, unless they are kept",
                )
        self._changed()
        return Changed(row, voiding.voided)

    def set_start_page(self, user_id: int, path: str) -> User:
        """Store the page that opens after sign-in; "" for the start page of the role. Raises BadInput if the path is
        not a page of the console."""
        if path:
            check_page_path(path)
        with self._database.unit_of_work() as session:
            row = store.user(session, user_id)
            row.start_page = path
        self._changed()
        return row

    def set_password(self, user_id: int, password: str, verified_hash: str | None = None) -> User:
        """Set a new password. All sessions of the user end, and the password links of the user become invalid.

        ``verified_hash``: hash of the password that the user has entered to change it. Raises NotPermitted if the password
        has been changed since.
        """
        hashed = self._hashed(password, self.get(user_id).name)
        with self._database.unit_of_work() as session:
            if verified_hash is not None and not store.replace_hash(session, user_id, verified_hash, hashed):
                raise NotPermitted("the password was changed meanwhile", hint="sign in again")
            row = self._store_password(session, user_id, hashed)
        self._changed()
        return row

    def set_password_by_link(self, key: str, password: str) -> User:
        """Set a password with a one-time link. Raises NotPermitted if the link was used, has expired or never existed."""
        row = self.get(self._fresh(PASSWORD, key).user_id or 0)
        hashed = self._hashed(password, row.name)
        with self._database.unit_of_work() as session:
            if store.take_link(session, PASSWORD, key_hash(key), self._now()) is None:
                raise _used_link()
            row = self._store_password(session, row.id, hashed)
        self._changed()
        return row

    def check_link(self, kind: str, key: str) -> None:
        """Raise NotPermitted if the link is not valid, without using it."""
        self._fresh(kind, key)
        if kind == SETUP and not self.set_up_needed():
            raise _used_link()

    def _fresh(self, kind: str, key: str) -> OneTimeLink:
        """Return a valid link without marking the link as used. Callers check the link before slow work, and mark it as
        used in the transaction of the change. Raises NotPermitted if the link is not valid."""
        with self._database.unit_of_work() as session:
            link = store.fresh_link(session, kind, key_hash(key), self._now())
        if link is None:
            raise _used_link()
        return link

    def _store_password(self, session: Any, user_id: int, hashed: str) -> User:
        row = store.user(session, user_id)
        row.password_hash, row.password_changed = hashed, self._now()
        store.end_sign_ins(session, row.id, self._now(), "the password was changed")
        store.void_links(session, PASSWORD, row.id, self._now())
        return row

    # --- links --------------------------------------------------------------------------------------------------

    def set_up_link(self) -> Link | None:
        """Create a set-up link that replaces earlier ones. Return None if a user already exists."""
        with self._database.unit_of_work() as session:
            if store.any_user(session):
                return None
            return self._link(session, SETUP, None, SETUP_LASTS, by="")

    def password_link(self, user_id: int, until: datetime | None = None, *, by: str) -> Link:
        """Create a password link that replaces earlier ones. ``until``: latest expiry. Raises Conflict if the user is
        disabled."""
        with self._database.unit_of_work() as session:
            if not store.user(session, user_id).enabled:
                raise Conflict("this user is deactivated", hint="activate the user first")
            return self._link(session, PASSWORD, user_id, PASSWORD_LASTS, until, by=by)

    def _link(
        self, session: Any, kind: str, user_id: int | None, lasts: timedelta, until: datetime | None = None, *, by: str
    ) -> Link:
        now, key = self._now(), new_key()
        end = now + lasts if until is None else min(now + lasts, until)
        store.void_links(session, kind, user_id, now)
        row = OneTimeLink(kind=kind, user_id=user_id, key_hash=key_hash(key), created=now, expires=end, created_by=by)
        store.add_link(session, row)
        return Link(key, end)


def checked_name(name: str) -> str:
    """Return a user name in Unicode form NFKC. Raises BadInput for invisible characters, mixed scripts, or names reserved for
    software."""
    name = checked_user(unicodedata.normalize("NFKC", name))
    if any(c in UNSEEN or unicodedata.name(c, "").startswith(VARIATION) for c in name) or "  " in name:
        raise BadInput("the user name is not valid", expected="printable characters, single spaces", got=ascii(name))
    check_script(name)
    if store.name_key(name) in OF_SOFTWARE or store.name_key(name).startswith(BEGIN_OF_SOFTWARE):
        raise BadInput("this name is reserved", expected="a different name", got=name)
    return name


def _used_link() -> NotPermitted:
    return NotPermitted(
        "this link is invalid, expired or already used",
        expected="an unused link that has not expired",
        hint="ask an admin for a new link. Before the first user exists, restart the server to print a new link",
    )
