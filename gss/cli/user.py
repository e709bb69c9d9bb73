"""``gss user``: manage users, for example create the first user without a browser or reset a forgotten password."""

from __future__ import annotations

import argparse
import getpass
import sys
from typing import TYPE_CHECKING

from gss.cli.accounts_store import AccountAdministration, account_store, with_data
from gss.operations.accounts.permissions import ROLES

if TYPE_CHECKING:
    from gss.cli import Commands
    from gss.store.models import User


def register(subparsers: Commands) -> None:
    """Add the commands."""
    parser = subparsers.add_parser("user")
    subcommands = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    with_data(subcommands.add_parser("list", help="list all users")).set_defaults(run=list_users)
    p = with_data(
        subcommands.add_parser(
            "add", help="create a user; without a password option, print a one-time link to set the password"
        )
    )
    p.add_argument("name")
    p.add_argument("--role", required=True, choices=ROLES)
    _with_password(p)
    p.set_defaults(run=add_user)
    p = with_data(subcommands.add_parser("password", help="set a new password; ends all sessions of the user"))
    p.add_argument("name")
    _with_password(p)
    p.set_defaults(run=set_password)
    p = with_data(subcommands.add_parser("link", help="print a one-time link for a new password"))
    p.add_argument("name")
    p.set_defaults(run=print_link)
    p = with_data(subcommands.add_parser("role", help="change the role of a user"))
    p.add_argument("name")
    p.add_argument("role", choices=ROLES)
    _with_keep(p)
    p.set_defaults(run=change_role)
    p = with_data(subcommands.add_parser("disable", help="disable a user and end all sessions"))
    p.add_argument("name")
    _with_keep(p)
    p.set_defaults(run=switch, enabled=False)
    p = with_data(subcommands.add_parser("enable", help="activate a user"))
    p.add_argument("name")
    p.set_defaults(run=switch, enabled=True, keep_created=False)


def _with_keep(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--keep-created",
        action="store_true",
        help="keep users and links created by an admin who is demoted or disabled",
    )


def _with_password(parser: argparse.ArgumentParser) -> None:
    password_source = parser.add_mutually_exclusive_group()
    password_source.add_argument("--password-stdin", action="store_true", help="read the password from standard input")
    password_source.add_argument("--ask", action="store_true", help="ask for the password on the terminal")


def list_users(arguments: argparse.Namespace) -> int:
    """Print name, role and state of each user."""
    with account_store(arguments) as store:
        for row in store.accounts.users.list_all():
            state = "on" if row.enabled else "off"
            last_sign_in = f"{row.last_sign_in:%Y-%m-%d %H:%MZ}" if row.last_sign_in else "never"
            print(
                f"{row.name:<24} {row.role:<18} {state:<4} last sign-in {last_sign_in}  {row.disabled_reason}".rstrip()
            )
    return 0


def add_user(arguments: argparse.Namespace) -> int:
    """Create a user."""
    password = _password(arguments)
    with account_store(arguments) as store:
        row = store.accounts.users.add(arguments.name, arguments.role, by=store.user, password=password)
        store.record("user_add", f"{row.name} as {row.role}")
        print(f"{row.name} is {row.role}")
        if not password:
            _print_link(store, row)
    return 0


def set_password(arguments: argparse.Namespace) -> int:
    """Change the password of a user. Without a new password, print a one-time link."""
    password = _password(arguments)
    with account_store(arguments) as store:
        row = _find_user(store, arguments.name)
        if not password:
            return _print_link(store, row)
        store.accounts.users.set_password(row.id, password)
        store.record("user_password", row.name)
        print(f"{row.name} has a new password; all sessions ended")
    return 0


def print_link(arguments: argparse.Namespace) -> int:
    """Print a one-time password link."""
    with account_store(arguments) as store:
        return _print_link(store, _find_user(store, arguments.name))


def change_role(arguments: argparse.Namespace) -> int:
    """Change a user's role. The change applies from the next request."""
    with account_store(arguments) as store:
        user_id, keep = _find_user(store, arguments.name).id, arguments.keep_created
        changed = store.accounts.users.change(user_id, role=arguments.role, keep_created=keep)
        store.record("user_role", f"{changed.user.name} as {changed.user.role}", str(changed.voided))
        print("; ".join(filter(None, (f"{changed.user.name} is {changed.user.role}", str(changed.voided)))))
    return 0


def switch(arguments: argparse.Namespace) -> int:
    """Enable or disable a user."""
    with account_store(arguments) as store:
        user_id, keep = _find_user(store, arguments.name).id, arguments.keep_created
        changed = store.accounts.users.change(user_id, enabled=arguments.enabled, keep_created=keep)
        row, voided_text = changed.user, str(changed.voided)
        store.record("user_enable" if row.enabled else "user_disable", row.name, voided_text)
        print("; ".join(filter(None, (f"{row.name} is {'active' if row.enabled else 'disabled'}", voided_text))))
    return 0


def _print_link(store: AccountAdministration, row: User) -> int:
    from gss.api.serving import address_of

    link = store.accounts.users.password_link(row.id, by=store.user)
    store.record("user_link", row.name)
    address = address_of(store.settings, store.settings.port)
    print(f"{row.name} can set a password at {address}/welcome#{link.key} once, until {link.expires:%Y-%m-%d %H:%MZ}")
    return 0


def _find_user(store: AccountAdministration, name: str) -> User:
    from gss.domain.errors import NotFound

    row = store.accounts.users.named(name)
    if row is None:
        raise NotFound("no such user", got=name, hint="run gss user list to list them")
    return row


def _password(arguments: argparse.Namespace) -> str:
    """Read the password from standard input or the terminal. It is never an argument, because every user of the machine
    can read the command line."""
    from gss.domain.errors import BadInput

    if arguments.password_stdin:
        password = sys.stdin.readline().rstrip("\r\n")
        if not password:
            raise BadInput("no password on standard input", expected="one line")
        return password
    if arguments.ask:
        password = getpass.getpass("Password: ")
        if password != getpass.getpass("Repeat password: "):
            raise BadInput("the passwords differ")
        return password
    return ""
