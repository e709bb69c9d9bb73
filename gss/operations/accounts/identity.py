"""Who asks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime

from gss.operations.accounts.permissions import permissions_of, permitted, require

TOKEN_PREFIX = "token:"  # noqa: S105 - the beginning of a name


@dataclass(frozen=True)
class Who:
    """Somebody who proved who they are. ``kind``: session or token, ``key_id`` its row. ``csrf``: what a page must send with a
    change; "" for a token, which no browser sends by itself. ``expires``: the end of session or token."""

    name: str
    role: str
    permissions: frozenset[str]
    kind: str
    key_id: int
    user_id: int | None
    csrf: str
    expires: datetime

    def may(self, wanted: str) -> bool:
        """Is it permitted?"""
        return permitted(self.permissions, wanted)

    def require(self, wanted: str) -> None:
        """NotPermitted otherwise."""
        require(self.permissions, wanted, self.role)

    def require_all(self, role: str, scopes: Iterable[str]) -> None:
        """NotPermitted unless one may oneself all that a role with these scopes may: nobody hands out more than they have."""
        for wanted in sorted(permissions_of(role, scopes)):
            self.require(wanted)

    @property
    def handed_out_until(self) -> datetime | None:
        """The end of what one hands out, keys or links: a token's own; of a session none."""
        return self.expires if self.kind == "token" else None
