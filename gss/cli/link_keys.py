"""``gss link-keys``: create and change the keys that authenticate packets to the sensor."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gss.cli import Commands

DESCRIPTION = """Keys of link authentication. To replace the active key: add a new key (--add), install the file on the sensor,
then sign with the new key (--activate). The keys are never printed."""


def register(subparsers: Commands) -> None:
    """Add the command."""
    parser = subparsers.add_parser("link-keys", description=DESCRIPTION)
    parser.add_argument("file", type=Path, help="key file; only its owner may read it")
    change = parser.add_mutually_exclusive_group()
    change.add_argument("--new", action="store_true", help="create the file with one random key, in slot 0")
    change.add_argument("--add", action="store_true", help="store a new random key in the inactive slot")
    change.add_argument("--activate", type=int, choices=(0, 1), help="sign with the key of this slot from now on")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Change the key file and print the state of its slots."""
    from gss.device.link_keys import new_link_keys, read_link_keys, with_new_key, write_link_keys
    from gss.device.protocol.authentication import LinkKeys
    from gss.domain.errors import Conflict

    path: Path = arguments.file
    if arguments.new:
        if path.exists():
            raise Conflict(f"{path} exists", hint="add a key to it with --add")
        keys = new_link_keys()
    else:
        keys = read_link_keys(path)
        if arguments.add:
            keys = with_new_key(keys)
        elif arguments.activate is not None:
            keys = LinkKeys(keys.keys, arguments.activate)
    write_link_keys(path, keys)
    for slot in sorted(keys.keys):
        print(f"slot {slot}: {'active' if slot == keys.active else 'ready'}")
    return 0
