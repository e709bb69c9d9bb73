"""The identity of a caller."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime

from gss.domain.errors import BadInput
from gss.operations.accounts.permissions import permissions_of, permitted, require

MAX_NAME_LENGTH = 60
TOKEN_PREFIX = "token:"  # noqa: S105 - the beginning of a name


@dataclass(frozen=True)
class CallerIdentity:
    """An authenticated caller. ``kind``: session or token. ``key_id``: id of the session's or token's row. ``csrf``: CSRF token
    that a page must send with a change; "" for an API token, which browsers never send automatically. ``expires``: expiry of
    the session or token. ``start_page``: page that the user chose to open after sign-in, "" if none was chosen."""

    name: str
    role: str
    permissions: frozenset[str]
    kind: str
    key_id: int
    user_id: int | None
    csrf: str
    expires: datetime
    start_page: str = ""

    def may(self, permission: str) -> bool:
        """True if the caller has the permission."""
        return permitted(self.permissions, permission)

    def require(self, permission: str) -> None:
        """Raise NotPermitted if the caller does not have the permission."""
        require(self.permissions, permission, self.role)

    def require_all(self, role: str, scopes: Iterable[str]) -> None:
        """Raise NotPermitted unless the caller has all permissions of the role, restricted to these scopes. Callers
        cannot grant permissions that they do not have."""
        for permission in sorted(permissions_of(role, scopes)):
            self.require(permission)

    @property
    def handed_out_until(self) -> datetime | None:
        """Latest permitted expiry of keys and links that the caller creates: the expiry of a token, None for a session."""
        return self.expires if self.kind == "token" else None


def checked_user(user: str) -> str:
    """Return the user name if it can be displayed and stored. Raises BadInput otherwise."""
    if not 0 < len(user) <= MAX_NAME_LENGTH or not user.isprintable() or user.strip() != user:
        raise BadInput(
            "the user name is not valid", expected=f"1 – {MAX_NAME_LENGTH} printable characters", got=repr(user[:80])
        )
    return user
