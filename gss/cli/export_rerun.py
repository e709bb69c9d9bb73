"""``gss export rerun``: write frames, a contact, a calibration, an analysis or a campaign as one Rerun recording."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from gss.cli.whole_files import write_whole

if TYPE_CHECKING:
    from gss.cli import Subparsers


def register(kinds: Subparsers) -> None:
    """Add the command."""
    parser = kinds.add_parser("rerun", help="write stored data as a Rerun recording")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--frames", help="ids of frames, for example 3,5-9")
    source.add_argument(
        "--contact", type=int, metavar="N", help="all data of a contact: frames, telemetry, commands, events"
    )
    source.add_argument("--calibration", type=int, metavar="N", help="frames used for a calibration")
    source.add_argument("--analysis", type=int, metavar="N", help="frames of an analysis")
    source.add_argument("--campaign", type=int, metavar="N", help="frames of a campaign")
    parser.add_argument("--out", required=True, type=Path, help="file to write (.rrd)")
    parser.add_argument("--data", type=Path, help="data folder (GSS_DATA)")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Write the recording."""
    from gss.cli.records import services_of
    from gss.operations.recordings.ranges import ids_of

    services = services_of(arguments)
    scopes = services.recordings.scopes
    if arguments.frames is not None:
        scope = scopes.of_frames(ids_of(arguments.frames))
    elif arguments.contact is not None:
        scope = scopes.of_contact(arguments.contact)
    elif arguments.calibration is not None:
        scope = scopes.of_calibration(arguments.calibration)
    elif arguments.analysis is not None:
        scope = scopes.of_analysis(arguments.analysis)
    else:
        scope = scopes.of_campaign(arguments.campaign)
    data = services.recordings.stored.write(scope)
    write_whole(arguments.out, data)
    print(f"{arguments.out}: {len(data)} bytes, {len(scope.frame_ids)} frames")
    return 0
