"""``gss render``: render a test image of a pointing, with its truth."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

from gss.cli.instruments import CAMERA_HELP, registry
from gss.cli.solve import angles, attitude, julian_year
from gss.domain.errors import BadInput
from gss.operations.clock import utc_now

if TYPE_CHECKING:
    from gss.cli import Commands


def register(subparsers: Commands) -> None:
    """Add the command to the parser."""
    parser = subparsers.add_parser(
        "render",
        description="Render the sky at a pointing as a camera sees it (PNG). Upload the file on the page Frames; from "
        "there it can be sent to the image memory of a unit. gss solve FILE --truth checks the result of a chain.",
    )
    parser.add_argument("--camera", required=True, metavar="INSTRUMENT", help=CAMERA_HELP)
    parser.add_argument("--at", required=True, metavar="RA,DEC,ROLL", help="pointing in degrees (ICRS)")
    parser.add_argument("--out", required=True, type=Path, metavar="FILE.png", help="image to write")
    parser.add_argument(
        "--truth", type=Path, metavar="FILE.json", help="also write the attitude, for gss solve --truth"
    )
    parser.add_argument("--exposure", type=float, metavar="S", help="exposure time (default: exposure of the camera)")
    parser.add_argument(
        "--rate", default="0,0,0", metavar="X,Y,Z", help="angular rate about the camera's axes, °/s (default: 0,0,0)"
    )
    parser.add_argument(
        "--false-stars", type=int, default=0, metavar="N", help="number of spots that are not catalogue stars"
    )
    parser.add_argument(
        "--star-colours",
        action="store_true",
        help="brightness by colour index and spectral response of the camera instead of V",
    )
    parser.add_argument(
        "--corner-blur-px",
        type=float,
        default=0.0,
        metavar="PX",
        help="field curvature: additional width (1 sigma) of a star image in the corner (default: 0)",
    )
    parser.add_argument(
        "--row-skew-ms",
        type=float,
        default=0.0,
        metavar="MS",
        help="rolling shutter: time from the exposure of the first row to that of the last row (default: 0)",
    )
    parser.add_argument("--no-noise", action="store_true", help="render the expected values")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="seed of noise and false stars (default: 1)")
    parser.add_argument("--epoch", type=float, metavar="YEAR", help="Julian year of the star positions (default: now)")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Write the image, and the truth if requested."""
    from gss.operations.frames.pictures import png
    from gss.operations.frames.rendered_image import RenderRequest, draw

    if arguments.out.suffix.lower() != ".png":
        raise BadInput("unknown image format", expected="a file that ends in .png", got=arguments.out.name)
    if arguments.seed < 0:
        raise BadInput("seed is out of range", expected="0 or more", got=str(arguments.seed))
    pointing = angles(arguments.at, (3,), "RA,DEC,ROLL in degrees")
    x, y, z = (math.radians(v) for v in angles(arguments.rate, (3,), "X,Y,Z in °/s"))
    profile = registry().camera(arguments.camera)
    drawn = draw(
        profile,
        RenderRequest(
            attitude(pointing),
            arguments.exposure,
            (x, y, z),
            arguments.false_stars,
            not arguments.no_noise,
            arguments.seed,
            julian_year(utc_now()) if arguments.epoch is None else arguments.epoch,
            arguments.star_colours,
            arguments.corner_blur_px,
            arguments.row_skew_ms,
        ),
    )
    picture = profile.sensor.dark_columns.join(drawn.pixels, drawn.dark)
    arguments.out.write_bytes(png(picture))
    if arguments.truth:
        arguments.truth.write_text(json.dumps({arguments.out.name: pointing}) + "\n", "utf-8")
    limit = profile.sensor.faint_limit_mag
    bright = int((drawn.truth.v_mag <= limit).sum())
    rows, columns = picture.shape
    print(f"{arguments.out}: {columns} x {rows} px, {bright} stars to V {limit:g}, {arguments.false_stars} false stars")
    return 0
