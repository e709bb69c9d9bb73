"""``gss catalogue upload``: send a bank image directly to a device, verify it and optionally activate it."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from gss.cli import instruments
from gss.cli.input_files import IMAGE_BYTES, read_limited

if TYPE_CHECKING:
    from gss.cli import Subparsers
    from gss.device.session_events import TransferUpdate


def register(commands: Subparsers) -> None:
    """Add the command to the catalogue group."""
    parser = commands.add_parser(
        "upload", help="upload a bank image to a device: verify by read-back, commit, optionally activate"
    )
    parser.add_argument("image", type=Path, help="bank image from gss catalogue build")
    parser.add_argument(
        "--device",
        required=True,
        metavar="URL",
        help="port of the device: a tty, or a socket://, rfc2217://, udp://, zmq:// or can:// URL",
    )
    parser.add_argument("--bank", required=True, help="an inactive bank, for example A")
    parser.add_argument("--activate", action="store_true", help="activate the bank and confirm it (critical)")
    instruments.add_option(parser)
    parser.add_argument("--keys", type=Path, metavar="FILE", help="sign packets with these link keys")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Upload the image, and activate it if requested."""
    from gss.device.link_keys import packet_signer
    from gss.domain.errors import BadInput
    from gss.operations.checks.direct import direct_device
    from gss.operations.clock import monotonic_s, utc_us

    if not arguments.image.is_file():
        raise BadInput("no such file", got=str(arguments.image))
    image = read_limited(arguments.image, IMAGE_BYTES)
    signer = packet_signer(arguments.keys, utc_us) if arguments.keys else None
    unit = instruments.chosen(arguments)
    with direct_device(arguments.device, unit, monotonic_s, signer) as device:
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
