"""``gss rate``: print the angular rates of an image sequence, measured from its stars without a catalogue."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING

from gss.cli.input_files import read_file
from gss.cli.instruments import CAMERA_HELP, registry
from gss.domain.errors import BadInput

if TYPE_CHECKING:
    from gss.cli import Commands
    from gss.operations.frames.star_rate_sequence import StarRateRecord

SOLVED_EXIT, BAD_INPUT_EXIT, NO_RATE_EXIT = 0, 2, 3


def register(subparsers: Commands) -> None:
    """Add the command to the parser."""
    parser = subparsers.add_parser(
        "rate",
        description="Measure the angular rate between successive images from their stars alone, without a catalogue. "
        "Rotations of more than 180° between two images cannot be distinguished from smaller ones in the opposite direction. Exit "
        "code 0: a rate between all images, 2: bad input, 3: no rate between at least two images.",
    )
    parser.add_argument("files", nargs="+", metavar="FILE", help="images in time order (FITS, PNG, TIFF, JPEG)")
    parser.add_argument("--camera", required=True, metavar="INSTRUMENT", help=f"calibrated camera: {CAMERA_HELP}")
    parser.add_argument(
        "--interval",
        type=float,
        metavar="S",
        help="seconds between images without time stamps, or with time stamps too coarse to differ",
    )
    parser.add_argument(
        "--method",
        default="auto",
        choices=("auto", "pair", "triangle", "rate"),
        help="how stars are matched between two images (default: rate match if a rate is known, else triangle or pair)",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="change a constant of the chain far_mst, for example max_centroids=3; see docs/chains.md",
    )
    parser.add_argument("--json", action="store_true", help="print JSON, one object per file and line")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Measure the rates. Return 3 if one is missing."""
    from gss.operations.frames.frame_files import MAX_BYTES, ImportedFrame, read_frame
    from gss.operations.frames.star_rate_sequence import StarRateSequencer
    from gss.operations.parsing.parse_processes import ParseProcesses
    from gss.pipeline.chains.options import parse

    if len(arguments.files) < 2:
        raise BadInput("a rate needs two images", expected="two or more files", got=str(len(arguments.files)))
    profile = registry().camera(arguments.camera)
    sequencer = StarRateSequencer(profile, arguments.interval, arguments.method, parse(arguments.set))
    missing = 0
    with ParseProcesses() as parsing:
        for k, name in enumerate(arguments.files):
            data = read_file(name, "an image file", MAX_BYTES)
            image = parsing.parse(read_frame, data, name, classes=(ImportedFrame,), subject=name)
            record = sequencer.measure(image.pixels, image.taken_at, image.exposure_s)
            record["file"] = name
            missing += k > 0 and record["rate"] is None
            print(json.dumps(record, allow_nan=False) if arguments.json else as_text(record))
            sys.stdout.flush()
    return NO_RATE_EXIT if missing else SOLVED_EXIT


def as_text(record: StarRateRecord) -> str:
    """Return the rate as one line."""
    rate = record["rate"]
    if rate is None:
        return f"{record['file']}: {record['stars']} stars, no rate: {record['reason']}"
    x, y, z = rate["deg_s"]
    sigma = ", ".join("unknown" if s is None else f"{s:.2g}" for s in rate["sigma_deg_s"])
    return (
        f"{record['file']}: {record['matched']} of {record['stars']} stars matched ({record['method']}), rate "
        f"{x:+.5f}, {y:+.5f}, {z:+.5f} °/s about camera x, y, z; σ {sigma}; {rate['speed_deg_s']:.5f} °/s"
    )
