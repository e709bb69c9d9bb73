"""``gss notify``: check the notification file, and send a test message without a server."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gss.cli import Commands


def register(subparsers: Commands) -> None:
    """Add the commands."""
    subcommands = subparsers.add_parser("notify").add_subparsers(dest="kind", required=True, metavar="WHAT")
    parser = subcommands.add_parser("check", help="read the file and list its targets and rules; nothing is sent")
    parser.add_argument("file", help="file of targets and rules, in the format of GSS_NOTIFICATIONS")
    parser.set_defaults(run=check)
    parser = subcommands.add_parser("test", help="send a test message to one target")
    parser.add_argument("file", help="file of targets and rules, in the format of GSS_NOTIFICATIONS")
    parser.add_argument("target", help="name of the target")
    parser.add_argument("--private", action="store_true", help="permit a loopback or private address")
    parser.set_defaults(run=test)


def check(arguments: argparse.Namespace) -> int:
    """Print targets and rules."""
    from gss.operations.notifications.rules_file import read_rules

    rules = read_rules(arguments.file)
    for target in rules.targets:
        print(f"Target {target.name}: {'mail' if target.mail else 'webhook'}, {target.host}")
    for rule in rules.rules:
        print(f"Rule {rule.name}: {rule.words}")
    return 0


def test(arguments: argparse.Namespace) -> int:
    """Send a test message immediately and print the result."""
    import secrets

    from gss.domain.errors import NotFound
    from gss.operations.notifications.rules_file import read_rules
    from gss.operations.notifications.senders import OutgoingMessage, Sender

    rules = read_rules(arguments.file)
    target = rules.target(arguments.target)
    if target is None:
        raise NotFound(
            "There is no such target", expected=", ".join(t.name for t in rules.targets), got=arguments.target
        )
    message = OutgoingMessage(secrets.token_hex(16), "ok", "[GSS] ok: test message", "Test message by gss notify test.")
    rejected = Sender(arguments.private).send(target, message)
    print(f"Sent to {target.name}" + (f"; {rejected}" if rejected else ""))
    return 0
