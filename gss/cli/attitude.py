"""``gss attitude``: attitudes of stored frames as CCSDS messages, and their comparison with another system."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from gss.cli.whole_files import write_whole

if TYPE_CHECKING:
    from gss.cli import Commands


def register(subparsers: Commands) -> None:
    """Add the commands."""
    subcommands = subparsers.add_parser("attitude").add_subparsers(dest="kind", required=True, metavar="WHAT")
    parser = subcommands.add_parser("export", help="write the attitudes of stored frames as a CCSDS AEM or ACM")
    parser.add_argument("--from", dest="start", metavar="TIME", required=True, help="start, ISO 8601, UTC by default")
    parser.add_argument("--to", dest="end", metavar="TIME", required=True, help="end, ISO 8601")
    parser.add_argument("--format", default="aem", choices=("aem", "acm"), help="default aem; acm includes variances")
    _with_origin(parser)
    parser.add_argument("--out", type=Path, help="file to write; standard output without it")
    parser.set_defaults(run=export_attitudes)
    parser = subcommands.add_parser("compare", help="compare stored frames with the attitudes of a CCSDS AEM or ACM")
    parser.add_argument("file", type=Path, help="attitude message in KVN")
    _with_origin(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object with every frame")
    parser.set_defaults(run=compare_attitudes)


def _with_origin(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--origin", default="ground", choices=("ground", "on board"), help="default ground")
    parser.add_argument("--data", type=Path, help="data folder (GSS_DATA)")


def export_attitudes(arguments: argparse.Namespace) -> int:
    """Write the attitudes of stored frames as a CCSDS message."""
    from gss.cli.records import parse_time, services_of

    exchange = services_of(arguments).passes.attitudes
    start, end = parse_time(arguments.start), parse_time(arguments.end)
    text = "".join(exchange.message(arguments.format, arguments.origin, start, end))
    if arguments.out is None:
        print(text, end="")
    else:
        write_whole(arguments.out, text.encode())
        print(f"{arguments.out}: {len(text)} bytes", file=sys.stderr)
    return 0


def compare_attitudes(arguments: argparse.Namespace) -> int:
    """Compare stored frames with a message. Print the mean rotation and the residuals."""
    from gss.api.present.attitudes import comparison
    from gss.cli.records import services_of

    services = services_of(arguments)
    with services.base.parsing:
        result = comparison(services.passes.attitudes.compare(arguments.file.read_bytes(), arguments.origin))
    if arguments.json:
        print(result.model_dump_json(indent=1))
        return 0
    print(f"{result.object_name}, {result.frame}: {result.frames} frames compared, {result.outside} outside")
    print(
        f"mean rotation to the camera {result.angle_deg:.4f}°, quaternion", *(f"{q:.9f}" for q in result.cam_from_frame)
    )
    print("residuals, rms about x, y, z of the camera:", *(f"{v:.1f}″" for v in result.rms_arcsec))
    return 0
