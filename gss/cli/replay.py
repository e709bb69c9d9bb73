"""``gss replay``: decode a raw capture at any speed with the decoder of the live line and print it, or run the
sensor's own chain on a stored frame and compare each stage."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Required, TypedDict

from gss.cli import instruments

if TYPE_CHECKING:
    from gss.cli import Commands
    from gss.operations.contacts.capture_decoder import Replayed

DESCRIPTION = """Decode the raw capture of a contact and print telemetry, events, commands and reports. Name all files of the
contact in order. Nothing is stored and no port is opened. Exit code 0: packets were decoded; 3: no packets.

With --frame: run the sensor's own chain on a stored frame, with the bank and the parameters that were active, and compare
each stage on board and on the ground. Exit code 0: equal; 3: a stage differs."""
NO_PACKETS_EXIT = DIFFERENT_EXIT = 3


def register(subparsers: Commands) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        "replay",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "files",
        nargs="*",
        type=Path,
        metavar="FILE",
        help="raw capture files, for example captures/contact-000012-000.raw",
    )
    parser.add_argument(
        "--speed", type=float, metavar="X", help="0.1 – 1000 times real time (default: as fast as possible)"
    )
    instruments.add_option(parser)
    parser.add_argument("--framing", choices=("cobs", "slip"), help="framing of the line (default: the instrument's)")
    parser.add_argument(
        "--received", action="store_true", help="the files are plain bytes received from the device, without times"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object per line, with all values")
    parser.add_argument(
        "--frame", type=int, metavar="ID", help="stored frame instead of files; the number is in the URL of its page"
    )
    parser.add_argument("--data", type=Path, help="data folder (GSS_DATA)")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Replay a frame or captures."""
    from gss.domain.errors import BadInput

    if (arguments.frame is None) == (not arguments.files):
        raise BadInput("no input for the replay", expected="capture files, or --frame ID", got="both or neither")
    return replay_captures(arguments) if arguments.frame is None else replay_frame(arguments)


def replay_frame(arguments: argparse.Namespace) -> int:
    """Print on-board and ground results of a frame, stage by stage."""
    from gss.api.present.frames import frame_replay
    from gss.cli.records import services_of

    replayed = frame_replay(arguments.frame, services_of(arguments).frames.replay.again(arguments.frame))
    if arguments.json:
        print(replayed.model_dump_json(indent=1))
    else:
        rows = [("stage", "result", "on board", "ground", "px", "arcsec")]
        rows += [
            (s.name, s.verdict, s.on_board, s.ground, _figure(s.difference_px), _figure(s.difference_arcsec))
            for s in replayed.stages
        ]
        widths = [min(40, max(len(row[k]) for row in rows)) for k in range(len(rows[0]))]
        for row in rows:
            print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
        print(f"\nframe {replayed.frame_id}: {replayed.text}")
    return 0 if replayed.text == "equal" else DIFFERENT_EXIT


def _figure(value: float | None) -> str:
    return "" if value is None else f"{value:.2g}"


def replay_captures(arguments: argparse.Namespace) -> int:
    """Decode captures and print the messages."""
    from gss.domain.errors import BadInput, NotFound
    from gss.operations.clock import monotonic_s
    from gss.operations.contacts.capture_decoder import CaptureDecoder, decoded
    from gss.operations.contacts.replay_capture import paced
    from gss.operations.line.capture_files import packed_path
    from gss.operations.line.raw_capture import read_captures, read_received

    missing = [str(path) for path in arguments.files if not (path.is_file() or packed_path(path).is_file())]
    if missing:
        raise NotFound("no such capture", got=", ".join(missing))
    unit = instruments.chosen(arguments)
    decoder = CaptureDecoder(unit.dictionary, arguments.framing or unit.link.framing)
    item_count = 0
    unreadable: list[Path] = []
    records = (
        read_received(arguments.files)
        if arguments.received
        else read_captures(arguments.files, lambda path, _: unreadable.append(path))
    )
    items = decoded(records, decoder)
    for replayed in paced(items, arguments.speed, monotonic_s, time.sleep):
        item_count += 1
        facts = plain_item(replayed)
        print(json.dumps(facts) if arguments.json else _line(facts), flush=bool(arguments.speed))
    counters = decoder.received
    if not counters.bytes and unreadable:
        raise BadInput(
            f"{unreadable[0]} is not a capture",
            expected="records with times in the format of GSS",
            hint="use --received for plain bytes that another program received",
        )
    print(
        f"{item_count} messages; {counters.bytes} bytes received, {counters.good} good packets, {counters.bad} damaged, "
        f"{counters.gaps} missing, {decoder.transfer_packets} of transfers, {decoder.foreign} of another dictionary, "
        f"{decoder.undecodable} unreadable",
        file=sys.stderr,
    )
    return 0 if item_count else NO_PACKETS_EXIT


class ReplayedMessage(TypedDict, total=False):
    """Replayed message as JSON values."""

    at: Required[str]
    kind: Required[str]
    name: Required[str]
    device_time_s: float
    request_id: int
    stage: str
    severity: str
    text: str
    values: Mapping[str, object]


def plain_item(replayed: Replayed) -> ReplayedMessage:
    """Return a message as JSON values."""
    from gss.device.session_events import DeviceEvent, HelloReceived, Telemetry
    from gss.operations.telemetry.telemetry import stored_values
    from gss.operations.telemetry.value_format import plain

    at, item = datetime.fromtimestamp(replayed.at_s, UTC), replayed.item
    time = at.isoformat(timespec="milliseconds").replace("+00:00", "Z")
    if isinstance(item, Telemetry):
        return {
            "at": time,
            "kind": "telemetry",
            "name": item.packet,
            "device_time_s": item.device_time_s,
            "request_id": item.request_id,
            "values": stored_values(item),
        }
    if isinstance(item, DeviceEvent):
        return {
            "at": time,
            "kind": "event",
            "name": item.name,
            "severity": item.severity,
            "device_time_s": item.device_time_s,
            "text": item.text,
        }
    if isinstance(item, HelloReceived):
        return {"at": time, "kind": "hello", "name": item.serial or item.device_model, "values": vars(item)}
    return {
        "at": time,
        "kind": "command",
        "name": item.name,
        "stage": item.stage,
        "request_id": item.request_id,
        "values": {name: plain(v) for name, v in item.values.items()},
        "text": item.detail,
    }


def _line(facts: ReplayedMessage) -> str:
    """Return time, kind, name and values as one line."""
    values = [
        f"{k}={v:.6g}" if isinstance(v, float) else f"{k}={v}"
        for k, v in facts.get("values", {}).items()
        if not isinstance(v, list)
    ]
    extra = " ".join(str(facts[k]) for k in ("stage", "severity", "text") if facts.get(k))
    line = f"{facts['at']} {facts['kind']:9} {facts['name']:16} {extra} {' '.join(values)}"
    return line if len(line) <= 200 else f"{line[:199]}…"
