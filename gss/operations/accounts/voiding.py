"""Withdrawal of users and links that an account created. If a token is revoked, or an admin is demoted or disabled, the one-time
links created with this account become invalid and the users created with it are disabled."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from gss.operations.accounts.identity import TOKEN_PREFIX
from gss.store import accounts as store
from gss.store.engine import Transaction
from gss.store.models import ApiToken, User

PASSWORD = "password"  # noqa: S105 - a kind of link
"""Kind of links that set a password."""
MAX_REASON_LENGTH = 200


@dataclass(frozen=True)
class Voided:
    """Result of a withdrawal. ``users``: names of the disabled users. ``links``: number of links that became invalid."""

    users: tuple[str, ...] = ()
    links: int = 0

    def __str__(self) -> str:
        """Return the text for the audit log, "" if nothing was withdrawn."""
        parts = [f"also disabled: {', '.join(self.users)}"] if self.users else []
        parts += [f"links invalidated: {self.links}"] if self.links else []
        return "; ".join(parts)


class Voiding:
    """Withdraws accounts in one transaction. ``spare_id``: user who makes the change and is not disabled."""

    def __init__(self, session: Transaction, now: datetime, spare_id: int | None) -> None:
        self._session, self._now, self._spare_id = session, now, spare_id
        self._users: list[str] = []
        self._links = 0

    @property
    def voided(self) -> Voided:
        """The users and links that were withdrawn up to now."""
        return Voided(tuple(self._users), self._links)

    def revoke(self, token: ApiToken) -> None:
        """Revoke a token, and withdraw the users, links and tokens that were created with it."""
        token.revoked = token.revoked or self._now
        maker = TOKEN_PREFIX + token.name
        for child in store.tokens_made_by(self._session, maker, token.created, token.revoked):
            self.revoke(child)
        self._made_with(token, f"{maker}, which was revoked")

    def withdraw(self, user: User, why: str) -> None:
        """Withdraw the users and links that a user created, directly or with tokens. ``why``: change of the user, which is part
        of the displayed reason."""
        reason = f"{user.name}, who {why}"
        self._made_by(user.name, user.created, self._now, reason)
        for token in store.tokens_owned_by(self._session, user.id):
            self._made_with(token, reason)

    def disable(self, user: User, reason: str) -> None:
        """Disable a user, end all sessions of the user, and invalidate the user's password links."""
        user.enabled, user.disabled_reason = False, reason[:MAX_REASON_LENGTH]
        store.end_sign_ins(self._session, user.id, self._now, "the user was deactivated")
        store.void_links(self._session, PASSWORD, user.id, self._now)
        self._session.flush()

    def _made_with(self, token: ApiToken, reason: str) -> None:
        """Withdraw the users and links that were created with a token. Only accounts created during the token's
        lifetime are searched, because a later token can have the same name."""
        self._made_by(TOKEN_PREFIX + token.name, token.created, token.revoked or self._now, reason)

    def _made_by(self, maker: str, since: datetime, until: datetime, reason: str) -> None:
        self._links += store.void_links_made_by(self._session, maker, since, until)
        for user in store.users_made_by(self._session, maker, since, until):
            if user.id != self._spare_id:
                self._users.append(user.name)
                self.disable(user, f"created by {reason}")
                self.withdraw(user, "was disabled")
