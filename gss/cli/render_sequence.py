"""``gss render --frames``: write a sequence of images of a moving camera, with a truth file beside them."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

import numpy as np

from gss.cli.input_files import TEXT_BYTES, read_file
from gss.cli.solve import angles, attitude, julian_year, moment
from gss.cli.whole_files import write_whole
from gss.domain.errors import BadInput, Conflict
from gss.operations.clock import utc_now

if TYPE_CHECKING:
    from datetime import datetime

    from gss.domain.angles import Array
    from gss.domain.camera_profile import CameraProfile
    from gss.operations.frames.rendered_image import RenderRequest
    from gss.operations.frames.rendered_sequence import Motion, RenderMoment
    from gss.pipeline.render import Rendered

TRUTH_NAME = "truth.json"


class StarTruth(TypedDict):
    """A star of an image: Hipparcos number, position in px at mid-exposure, magnitude V."""

    hip: int
    col_px: float
    row_px: float
    v_mag: float


class ImageTruth(TypedDict):
    """Truth of an image at mid-exposure. ``attitude_deg``: right ascension, declination, roll (ICRS). ``quaternion``:
    cam_from_icrs, scalar-last. ``rate_deg_s``: angular rate about the camera's axes. ``stars``: stars on the detector to the
    camera's faint limit, brightest first."""

    time_utc: str
    exposure_s: float
    attitude_deg: list[float]
    quaternion: list[float]
    rate_deg_s: list[float]
    stars: list[StarTruth]


def add_sequence_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a sequence."""
    group = parser.add_argument_group("sequence of images")
    group.add_argument(
        "--frames",
        type=int,
        metavar="N",
        help=f"number of images: --out is a folder, which receives FITS files and {TRUTH_NAME}",
    )
    group.add_argument("--interval", type=float, default=1.0, metavar="S", help="seconds between images (default: 1)")
    group.add_argument(
        "--start",
        metavar="TIME",
        help="time of the first image, ISO 8601 (default: now; first attitude of the message; epoch of the orbit)",
    )


def render_sequence(arguments: argparse.Namespace, profile: CameraProfile, request: RenderRequest) -> int:
    """Write the images and the truth. All input is checked, and the first image drawn, before a file is written. If the
    command is interrupted, the truth of the written images is stored. ``request``: its attitude, rate and epoch are replaced."""
    from dataclasses import replace

    from gss.operations.frames.rendered_sequence import draw_sequence, moments_of

    folder: Path = arguments.out
    if folder.suffix or (folder.exists() and not folder.is_dir()):
        raise BadInput("a sequence needs a folder", expected="--out FOLDER", got=str(folder))
    if arguments.truth is not None:
        raise BadInput(f"the truth of a sequence is {TRUTH_NAME} in its folder", expected="--frames without --truth")
    start, motion = _motion(arguments, request)
    exposure_s = profile.sensor.exposure_s if request.exposure_s is None else request.exposure_s
    moments = moments_of(motion, start, arguments.interval, arguments.frames, exposure_s)
    names = [f"image-{k + 1:04d}.fits" for k in range(len(moments))]
    check_new([folder / name for name in (*names, TRUTH_NAME)], arguments.overwrite)
    if arguments.epoch is None:
        request = replace(request, epoch_jyear=round(julian_year(start), 2))
    images = _first_drawn(draw_sequence(profile, request, moments))
    folder.mkdir(parents=True, exist_ok=True)
    stars = _write(folder, names, images, profile, exposure_s)
    print(f"{folder}: {len(names)} images, {min(stars)} to {max(stars)} stars to V {profile.sensor.faint_limit_mag:g}")
    return 0


def check_new(paths: Sequence[Path], overwrite: bool) -> None:
    """Raise Conflict if a file exists and may not be overwritten."""
    present = [path for path in paths if path.exists()]
    if present and not overwrite:
        more = f" and {len(present) - 1} more" if len(present) > 1 else ""
        raise Conflict(f"{present[0]}{more} would be overwritten", hint="choose another name, or add --overwrite")


def _motion(arguments: argparse.Namespace, request: RenderRequest) -> tuple[datetime, Motion]:
    """Return the time of the first image and the motion of the options."""
    from gss.operations.frames import rendered_sequence as sequences
    from gss.operations.parsing.parse_processes import ParseProcesses
    from gss.orbit.attitude import AttitudeHistory
    from gss.orbit.read_attitude import read_attitude_file
    from gss.orbit.read_orbit import read_orbit

    start = None if arguments.start is None else moment(arguments.start)
    if arguments.attitudes is not None:
        data = read_file(arguments.attitudes, "an attitude message", TEXT_BYTES)
        with ParseProcesses() as parsing:
            history = parsing.parse(
                read_attitude_file, data, classes=(AttitudeHistory,), subject=str(arguments.attitudes)
            )
        return start or _utc(float(history.times_s[0])), sequences.along_history(history)
    if arguments.orbit is not None:
        text = read_file(arguments.orbit, "an orbit file", TEXT_BYTES).decode("utf-8", "replace")
        orbit = read_orbit(text).orbit
        return start or orbit.epoch, sequences.earth_pointing(orbit)
    start = start or utc_now()
    return start, sequences.constant_rate(request.cam_from_icrs, np.array(request.rate_rad_s), start)


def _utc(unix_s: float) -> datetime:
    from datetime import UTC, datetime

    return datetime.fromtimestamp(unix_s, UTC)


def _first_drawn(images: Iterator[tuple[RenderMoment, Rendered]]) -> Iterator[tuple[RenderMoment, Rendered]]:
    """Return the same images, with the first already drawn, so that invalid options are rejected before a file is written."""
    from itertools import chain

    return chain([next(images)], images)


def _write(
    folder: Path,
    names: Sequence[str],
    images: Iterator[tuple[RenderMoment, Rendered]],
    profile: CameraProfile,
    exposure_s: float,
) -> list[int]:
    """Write images and truth, and return the number of stars of each image."""
    from gss.cli.night import show_progress
    from gss.operations.frames.fits_export import rendered_file

    truths: dict[str, ImageTruth] = {}
    dark_columns = profile.sensor.dark_columns
    try:
        for k, (name, (at, drawn)) in enumerate(zip(names, images, strict=True), 1):
            picture = dark_columns.join(drawn.pixels, drawn.dark)
            data = rendered_file(picture, name, at.at, exposure_s, profile.name, dark_columns)
            write_whole(folder / name, data)
            truths[name] = _truth(at, drawn, exposure_s, profile.sensor.faint_limit_mag)
            show_progress(k / len(names), f"Image {k} of {len(names)}")
    finally:
        if truths:
            write_whole(folder / TRUTH_NAME, (json.dumps(truths, allow_nan=False) + "\n").encode())
    return [len(truth["stars"]) for truth in truths.values()]


def _truth(at: RenderMoment, drawn: Rendered, exposure_s: float, faintest_mag: float) -> ImageTruth:
    from gss.domain.frames import ra_dec_roll_rad
    from gss.domain.rotation import matrix_from_quaternion

    truth = drawn.truth
    rows = zip(truth.hip, truth.pixels, truth.v_mag, strict=True)
    return {
        "time_utc": at.at.isoformat(timespec="milliseconds"),
        "exposure_s": exposure_s,
        "attitude_deg": _numbers(np.degrees(ra_dec_roll_rad(matrix_from_quaternion(at.quaternion)))),
        "quaternion": _numbers(at.quaternion),
        "rate_deg_s": _numbers(np.degrees(at.rate_rad_s)),
        "stars": [
            {"hip": int(hip), "col_px": round(float(p[0]), 4), "row_px": round(float(p[1]), 4), "v_mag": float(v)}
            for hip, p, v in rows
            if v <= faintest_mag
        ],
    }


def _numbers(values: Array) -> list[float]:
    return [float(v) for v in values]


def sky_attitude(arguments: argparse.Namespace) -> Array:
    """Return the (3, 3) attitude of ``--at``. For an attitude message or an orbit, it is only a placeholder for the first
    attitude of the sequence."""
    return np.eye(3) if arguments.at is None else attitude(angles(arguments.at, (3,), "RA,DEC,ROLL in degrees"))
