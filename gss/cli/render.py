"""``gss render``: render a test image of a pointing with its truth, or a picture of the optical bench."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from gss.cli.instruments import CAMERA_HELP, registry
from gss.cli.render_sequence import add_sequence_options, check_new, render_sequence, sky_attitude
from gss.cli.solve import angles, check_exposure, julian_year
from gss.cli.whole_files import write_whole
from gss.domain.errors import BadInput
from gss.operations.clock import utc_now

if TYPE_CHECKING:
    from gss.cli import Commands
    from gss.domain.camera_profile import CameraProfile


def register(subparsers: Commands) -> None:
    """Add the command to the parser."""
    parser = subparsers.add_parser(
        "render",
        description="Render the sky at a pointing as a camera sees it (PNG), or with --frames a sequence of images of a moving "
        "camera (FITS). Upload the file on the page Frames; from "
        "there it can be sent to the image memory of a unit. gss solve FILE --truth checks the result of a chain.",
    )
    parser.add_argument("--camera", required=True, metavar="INSTRUMENT", help=CAMERA_HELP)
    scene = parser.add_mutually_exclusive_group(required=True)
    scene.add_argument("--at", metavar="RA,DEC,ROLL", help="pointing in degrees (ICRS)")
    scene.add_argument(
        "--attitudes",
        metavar="FILE",
        help="with --frames: attitudes of the camera over time, a CCSDS AEM or ACM",
    )
    scene.add_argument(
        "--orbit",
        metavar="FILE",
        help="with --frames: orbit (TLE, OMM, OEM) of a camera that points to the zenith, +x along the velocity",
    )
    scene.add_argument(
        "--second-lens",
        type=float,
        metavar="RATIO",
        help="instead of the sky, the circle of light through a second lens that faces the camera, for gss bench "
        "second-lens: diameter of the pupils divided by their distance, for example 0.2",
    )
    parser.add_argument(
        "--second-lens-off",
        default="0,0",
        metavar="X,Y",
        help="displacement of the second lens in diameters of a pupil (default: 0,0)",
    )
    parser.add_argument(
        "--centre-off",
        default="0,0",
        metavar="COL,ROW",
        help="displacement of the principal point of the camera in px (default: 0,0)",
    )
    parser.add_argument("--out", required=True, type=Path, metavar="FILE.png|FOLDER", help="image to write")
    parser.add_argument("--overwrite", action="store_true", help="replace existing files")
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
    add_sequence_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Write the image, and the truth if requested."""
    if arguments.frames is None and arguments.at is None and arguments.second_lens is None:
        raise BadInput("attitudes over time need a number of images", expected="--frames N")
    if arguments.frames is None and arguments.out.suffix.lower() != ".png":
        raise BadInput("unknown image format", expected="a file that ends in .png", got=arguments.out.name)
    if arguments.seed < 0:
        raise BadInput("seed is out of range", expected="0 or more", got=str(arguments.seed))
    profile = _decentred(registry().camera(arguments.camera), arguments.centre_off)
    if arguments.frames is None:
        check_new([p for p in (arguments.out, arguments.truth) if p is not None], arguments.overwrite)
    if arguments.second_lens is not None:
        return _render_bench(arguments, profile)
    return _render_sky(arguments, profile)


def _decentred(profile: CameraProfile, text: str) -> CameraProfile:
    """Return the profile with a displaced principal point. Raises BadInput if it leaves the detector."""
    col, row = angles(text, (2,), "COL,ROW in px")
    camera = profile.camera
    moved = replace(camera, centre_col_px=camera.centre_col_px + col, centre_row_px=camera.centre_row_px + row)
    inside = 0 <= moved.centre_col_px < camera.columns and 0 <= moved.centre_row_px < camera.rows
    if (col or row) and not inside:
        got = f"{moved.centre_col_px:g}, {moved.centre_row_px:g} px"
        raise BadInput("principal point is out of range", expected="a point on the detector", got=got)
    return replace(profile, camera=moved)


def _render_bench(arguments: argparse.Namespace, profile: CameraProfile) -> int:
    """Write the picture through a second lens."""
    import numpy as np

    from gss.operations.frames.pictures import png
    from gss.pipeline.second_lens import SecondLens, through_second_lens

    if arguments.truth is not None:
        raise BadInput("a picture of the bench has no attitude", expected="--truth with --at", got="--second-lens")
    if arguments.frames is not None:
        raise BadInput("a picture of the bench has no motion", expected="--frames with --at", got="--second-lens")
    x, y = angles(arguments.second_lens_off, (2,), "X,Y in diameters of a pupil")
    camera = profile.camera
    lens = SecondLens(arguments.second_lens, (x, y))
    picture = through_second_lens(camera, profile.sensor, lens, np.random.default_rng(arguments.seed))
    write_whole(arguments.out, png(picture))
    centre = f"{camera.centre_col_px:g}, {camera.centre_row_px:g} px"
    print(f"{arguments.out}: {picture.shape[1]} x {picture.shape[0]} px, principal point {centre}")
    return 0


def _render_sky(arguments: argparse.Namespace, profile: CameraProfile) -> int:
    """Write the image of the sky, and the truth if requested."""
    from gss.operations.frames.pictures import png
    from gss.operations.frames.rendered_image import RenderRequest, draw

    check_exposure(arguments.exposure)
    x, y, z = (math.radians(v) for v in angles(arguments.rate, (3,), "X,Y,Z in °/s"))
    request = RenderRequest(
        sky_attitude(arguments),
        arguments.exposure,
        (x, y, z),
        arguments.false_stars,
        not arguments.no_noise,
        arguments.seed,
        julian_year(utc_now()) if arguments.epoch is None else arguments.epoch,
        arguments.star_colours,
        arguments.corner_blur_px,
        arguments.row_skew_ms,
    )
    if arguments.frames is not None:
        return render_sequence(arguments, profile, request)
    drawn = draw(profile, request)
    picture = profile.sensor.dark_columns.join(drawn.pixels, drawn.dark)
    write_whole(arguments.out, png(picture))
    if arguments.truth:
        pointing = angles(arguments.at, (3,), "RA,DEC,ROLL in degrees")
        write_whole(arguments.truth, (json.dumps({arguments.out.name: pointing}) + "\n").encode())
    limit = profile.sensor.faint_limit_mag
    bright = int((drawn.truth.v_mag <= limit).sum())
    rows, columns = picture.shape
    print(f"{arguments.out}: {columns} x {rows} px, {bright} stars to V {limit:g}, {arguments.false_stars} false stars")
    return 0
