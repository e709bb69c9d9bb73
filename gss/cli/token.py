"""``gss token``: manage API tokens."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from gss.cli.accounts_store import account_store, with_data
from gss.domain.errors import BadInput
from gss.operations.accounts.permissions import ALL, ROLES

if TYPE_CHECKING:
    from gss.cli import Commands


def register(subparsers: Commands) -> None:
    """Add the commands."""
    parser = subparsers.add_parser("token")
    subcommands = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    with_data(subcommands.add_parser("list", help="list all tokens, without the keys")).set_defaults(run=list_tokens)
    p = with_data(subcommands.add_parser("add", help="create a token; the key is printed once"))
    p.add_argument("name")
    p.add_argument("--role", required=True, choices=ROLES)
    p.add_argument("--days", type=float, default=90, help="days until expiry (default 90)")
    p.add_argument(
        "--only",
        metavar="PERMISSIONS",
        help=f"restrict the token to these permissions, separated by commas: {', '.join(sorted(ALL))}",
    )
    p.set_defaults(run=add_token)
    p = with_data(subcommands.add_parser("revoke", help="revoke a token"))
    p.add_argument("name")
    p.set_defaults(run=revoke_token)


def list_tokens(arguments: argparse.Namespace) -> int:
    """Print name, role and expiry of each token."""
    with account_store(arguments) as store:
        for row in store.accounts.tokens.list_all():
            state = f"revoked {row.revoked:%Y-%m-%d}" if row.revoked else f"until {row.expires:%Y-%m-%d %H:%MZ}"
            print(f"{row.name:<24} {row.role:<18} {state}  {', '.join(row.scopes)}".rstrip())
    return 0


def add_token(arguments: argparse.Namespace) -> int:
    """Create a token and print only its key, so that scripts can read it."""
    scopes = [scope.strip() for scope in (arguments.only or "").split(",") if scope.strip()]
    if arguments.only is not None and not scopes:  # no permissions mean all permissions of the role
        raise BadInput("--only has no permission", expected="permissions, separated by commas", got=arguments.only)
    with account_store(arguments) as store:
        new_token = store.accounts.tokens.add(
            arguments.name, arguments.role, arguments.days, by=store.user, scopes=scopes
        )
        store.record("token_add", f"{new_token.row.name} as {new_token.row.role}")
        print(new_token.key)
    return 0


def revoke_token(arguments: argparse.Namespace) -> int:
    """Revoke a token with immediate effect."""
    with account_store(arguments) as store:
        revoked = store.accounts.tokens.revoke_named(arguments.name)
        store.record("token_revoke", revoked.row.name, str(revoked.voided))
        print("; ".join(filter(None, (f"{revoked.row.name} is revoked", str(revoked.voided)))))
    return 0
