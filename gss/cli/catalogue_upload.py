"""``gss catalogue upload``: send a bank image directly to a device, verify it and optionally activate it."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from gss.cli.input_files import IMAGE_BYTES, read_limited

if TYPE_CHECKING:
    from gss.cli import Subparsers
    from gss.device.session_events import TransferUpdate


def register(commands: Subparsers) -> None:
    """Add the command to the catalogue group."""
    p = commands.add_parser(
        "upload", help="send a bank image to a device: verify by read-back, commit, activate if asked"
    )
    p.add_argument("image", type=Path, help="bank image, as build writes it")
    p.add_argument(
        "--device", required=True, metavar="URL", help="port of the device: a tty, socket:// or rfc2217:// URL"
    )
    p.add_argument("--bank", required=True, help="an inactive bank, for example A")
    p.add_argument("--activate", action="store_true", help="make it the active bank and confirm it (critical)")
    p.add_argument("--json", action="store_true", help="print one JSON object")
    p.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Upload the image, and activate it if requested."""
    from gss.device.dictionary_file import load_dictionary
    from gss.domain.errors import BadInput
    from gss.operations.clock import monotonic_s
    from gss.operations.line.direct import direct_device

    if not arguments.image.is_file():
        raise BadInput("no such file", got=str(arguments.image))
    image = read_limited(arguments.image, IMAGE_BYTES)
    with direct_device(arguments.device, load_dictionary(), monotonic_s) as device:
        sha256 = device.upload(image, arguments.bank, _show)
        if arguments.activate:
            device.command("ACTIVATE_BANK", {"bank": arguments.bank})
            device.command("CONFIRM_BANK", {"bank": arguments.bank})
        facts = {
            "device": device.hello.serial,
            "bank": arguments.bank,
            "bytes": len(image),
            "sha256": sha256,
            "active": arguments.activate,
        }
    print(json.dumps(facts) if arguments.json else "\n".join(f"{name}: {value}" for name, value in facts.items()))
    return 0


def _show(update: TransferUpdate) -> None:
    if sys.stderr.isatty():
        print(
            f"\r{update.state}: {update.stored_bytes} of {update.size} bytes stored",
            end="",
            file=sys.stderr,
            flush=True,
        )
