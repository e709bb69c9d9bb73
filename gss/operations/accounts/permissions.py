"""Permissions of each role. Routes, commands and pages use this table.

All roles have the permission ``stop``, which is sufficient for ABORT and for pausing, stopping and aborting work. A token that is
restricted to other permissions does not have it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from gss.domain.errors import BadInput, NotPermitted

VIEW = "view"
METRICS = "metrics"
"""Reading metrics. They contain no names or contents, so a monitoring token needs no other permission."""
STOP = "stop"
"""Sending ABORT, and pausing, stopping and aborting work in progress."""
EVERYBODY = (VIEW, METRICS, STOP)
GROUPS = ("attitude", "catalogue", "imager", "link", "power", "processor", "training")
COMMANDS = tuple(f"command.{group}" for group in GROUPS)
"""One permission per subsystem of the dictionary."""
FRAMES = ("frames.import", "frames.transfer", "frames.solve")
CATALOGUES = ("catalogues.build", "catalogues.upload")
ADMIN = (
    "admin.users",
    "admin.tokens",
    "admin.audit",
    "admin.health",
    "admin.retention",
    "admin.backup",
)
VIEWS = "views"
"""Storing shared views of the console."""
HEADS = "heads"
"""Changing spacecraft and the mountings of their heads."""
OPERATOR = (
    *COMMANDS,
    "link.open",
    "alarms",
    "limits",
    "derived",
    "procedures",
    "schedule",
    "passes",
    VIEWS,
    HEADS,
    "authority.take",
    "authority.break",
    "frames.transfer",
    "frames.solve",
    "catalogues.upload",
    "tables",
    "contacts.note",
    "replay",
    "jobs.cancel",
)
INSTRUMENTS = "instruments"
"""Checking and installing instrument packages."""
MANAGER = ("command.catalogue", "authority.take", *CATALOGUES, "tables", VIEWS, INSTRUMENTS, "jobs.cancel")
ENGINEER = (
    *FRAMES,
    "frames.pin",
    "calibrate",
    "analyse",
    "derived",
    "procedures",
    "campaigns",
    "tables",
    VIEWS,
    HEADS,
    INSTRUMENTS,
    "command.imager",
    "authority.take",
    "replay",
    "contacts.note",
    "jobs.cancel",
)
ALL = frozenset((*EVERYBODY, *OPERATOR, *MANAGER, *ENGINEER, *ADMIN))
ROLES: Mapping[str, frozenset[str]] = {
    "viewer": frozenset(EVERYBODY),
    "operator": frozenset((*EVERYBODY, *OPERATOR)),
    "catalogue manager": frozenset((*EVERYBODY, *MANAGER)),
    "engineer": frozenset((*EVERYBODY, *ENGINEER)),
    "admin": ALL,
}
START_PAGES: Mapping[str, str] = {
    "viewer": "/live",
    "operator": "/live",
    "catalogue manager": "/catalogues",
    "engineer": "/frames",
    "admin": "/admin",
}
"""Page of the console that opens after sign-in, unless the user has chosen another one."""


def permissions_of(role: str, scopes: Iterable[str] = ()) -> frozenset[str]:
    """Return the permissions of a role, restricted to ``scopes`` if any are given. An unknown role has no permissions."""
    granted, restricted = ROLES.get(role, frozenset()), frozenset(scopes)
    return granted & restricted if restricted else granted


def checked_role(role: str) -> str:
    """Return the name of the role. Raises BadInput if the role does not exist."""
    if role not in ROLES:
        raise BadInput("unknown role", expected=", ".join(ROLES), got=role[:40])
    return role


def permitted(permissions: frozenset[str], permission: str) -> bool:
    """True if the required permission is granted. ``permission``: one permission, or alternatives separated by |; ``command``
    stands for any command permission."""
    return any(
        alternative in permissions or (alternative == "command" and any(p in permissions for p in COMMANDS))
        for alternative in permission.split("|")
    )


def roles_with(permission: str) -> list[str]:
    """Return the roles that have the permission, in the order of the table."""
    return [role for role, permissions in ROLES.items() if permitted(permissions, permission)]


def require(permissions: frozenset[str], permission: str, role: str) -> None:
    """Raise NotPermitted if the permission is not granted. The error names the roles that have it."""
    if not permitted(permissions, permission):
        raise not_permitted(permission, role)


def not_permitted(permission: str, role: str) -> NotPermitted:
    """Return the error for a missing permission. It names the roles that have the permission."""
    roles = roles_with(permission)
    return NotPermitted(
        f"permission required: {permission.replace('|', ' or ')}",
        expected=f"the role {' or '.join(roles)}" if roles else "a permission that no role has",
        got=f"the role {role}" if role else "not signed in",
        hint="ask a user with that role, or ask an admin to change your role",
    )
