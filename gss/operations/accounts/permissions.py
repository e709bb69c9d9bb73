"""What each role may do: one table, asked by routes, by commands and by the pages.

Every role may stop: ABORT, pausing, stopping and aborting need ``stop`` alone. A token narrowed to other permissions may not.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from gss.domain.errors import BadInput, NotPermitted

VIEW = "view"
METRICS = "metrics"
"""Figures without names or contents: harmless, so that the token of a monitor can be the least of all."""
STOP = "stop"
"""ABORT, and pausing, stopping and aborting what runs."""
EVERYBODY = (VIEW, METRICS, STOP)
GROUPS = ("attitude", "catalogue", "imager", "link", "power", "processor", "training")
COMMANDS = tuple(f"command.{group}" for group in GROUPS)
"""One for each subsystem of the dictionary."""
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
OPERATOR = (
    *COMMANDS,
    "link.open",
    "alarms",
    "limits",
    "stacks",
    "schedule",
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
MANAGER = ("command.catalogue", "authority.take", *CATALOGUES, "tables", "jobs.cancel")
ENGINEER = (
    *FRAMES,
    "frames.pin",
    "calibrate",
    "analyse",
    "campaigns",
    "tables",
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


def permissions_of(role: str, scopes: Iterable[str] = ()) -> frozenset[str]:
    """What a role may do, narrowed to ``scopes`` where any are given; nothing for a role that is none."""
    granted, narrowed = ROLES.get(role, frozenset()), frozenset(scopes)
    return granted & narrowed if narrowed else granted


def checked_role(role: str) -> str:
    """A role's name."""
    if role not in ROLES:
        raise BadInput("no such role", expected=", ".join(ROLES), got=role[:40])
    return role


def permitted(permissions: frozenset[str], wanted: str) -> bool:
    """Does one of the alternatives hold? ``wanted`` is a permission, or some with | between; ``command`` is any command's."""
    return any(
        one in permissions or (one == "command" and any(p in permissions for p in COMMANDS))
        for one in wanted.split("|")
    )


def roles_with(wanted: str) -> list[str]:
    """Roles that may, in the order of the table."""
    return [role for role, permissions in ROLES.items() if permitted(permissions, wanted)]


def require(permissions: frozenset[str], wanted: str, role: str) -> None:
    """NotPermitted, with who has it, unless it is among the permissions."""
    if not permitted(permissions, wanted):
        raise not_permitted(wanted, role)


def not_permitted(wanted: str, role: str) -> NotPermitted:
    """The refusal as an operator can use it."""
    having = roles_with(wanted)
    return NotPermitted(
        f"this needs the permission {wanted.replace('|', ' or ')}",
        expected=f"the role {' or '.join(having)}" if having else "nobody has it",
        got=f"the role {role}" if role else "nobody signed in",
        hint="ask somebody who has that role, or an admin to change yours",
    )
