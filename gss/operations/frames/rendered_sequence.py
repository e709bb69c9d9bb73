"""Sequences of rendered images along a motion, with the attitude and rate of each image (Huffman 2006 ch. 7)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from gss.catalogue_tools.corrections.ephemeris import teme_from_icrs
from gss.catalogue_tools.envelope.attitude import BODY_FROM_CAM
from gss.catalogue_tools.envelope.orbits import jyear_of
from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix, turn_between, turned
from gss.operations.frames.rendered_image import RenderRequest, draw
from gss.orbit.attitude import AttitudeHistory
from gss.orbit.trajectory import Trajectory, unix_s
from gss.pipeline.render import Rendered, longest_trail_s

MAX_IMAGES = 2000
MAX_INTERVAL_S = 86_400.0
RATE_STEP_S = 0.5
"""Time before and after an image between which its rate is measured."""

Motion = Callable[[Array], Array]
"""Function that returns (n, 4) quaternions cam_from_icrs at (n,) Unix seconds, NaN where no attitude is known."""


@dataclass(frozen=True)
class RenderMoment:
    """One image of a sequence. ``at``: time of mid-exposure; ``quaternion``: (4,) cam_from_icrs at that time, scalar-last;
    ``rate_rad_s``: (3,) angular velocity in camera axes."""

    at: datetime
    quaternion: Array
    rate_rad_s: Array


def constant_rate(cam_from_icrs: Array, rate_rad_s: Array, start: datetime) -> Motion:
    """Return a motion with a constant (3,) rate in camera axes. ``cam_from_icrs``: (3, 3) attitude at ``start``."""
    first, start_s = quaternion_from_matrix(cam_from_icrs), unix_s(start)
    return lambda times_s: turned(first, -np.asarray(rate_rad_s) * (times_s - start_s)[:, None])


def along_history(history: AttitudeHistory) -> Motion:
    """Return the motion of an attitude message. The frame of the message is used as the axes of the camera."""
    return history.at


def earth_pointing(orbit: Trajectory) -> Motion:
    """Return the motion of a camera that points to the zenith of its orbit, with +x along the velocity. Its attitude is not
    known outside the time spans of the orbit."""

    def pointing(times_s: Array, first_s: float, last_s: float) -> Array:
        places, before, after = (
            orbit.teme_km(np.clip(times_s + step, first_s, last_s)) for step in (0.0, -RATE_STEP_S, RATE_STEP_S)
        )
        zenith = places / np.linalg.norm(places, axis=1, keepdims=True)
        normal = np.cross(zenith, after - before)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        orbit_from_teme = np.stack([np.cross(normal, zenith), -normal, -zenith], axis=1)
        to_teme = [teme_from_icrs(jyear_of(datetime.fromtimestamp(s, UTC))) for s in times_s]
        cam = BODY_FROM_CAM["zenith"].T @ orbit_from_teme @ np.stack(to_teme)
        return np.stack([quaternion_from_matrix(matrix) for matrix in cam])

    def motion(times_s: Array) -> Array:
        quaternions = np.full((len(times_s), 4), np.nan)
        for first_s, last_s in orbit.spans:
            inside = np.flatnonzero((times_s >= first_s) & (times_s <= last_s))
            if len(inside):
                quaternions[inside] = pointing(times_s[inside], first_s, last_s)
        return quaternions

    return motion


def moments_of(
    motion: Motion, start: datetime, interval_s: float, images: int, exposure_s: float
) -> list[RenderMoment]:
    """Return the moments of ``images`` images at intervals, the first at ``start``. Raises BadInput if the numbers are out of
    range, exposures overlap, or an attitude is not known."""
    if not 1 <= images <= MAX_IMAGES:
        raise BadInput("number of images is out of range", expected=f"1 – {MAX_IMAGES}", got=str(images))
    if not exposure_s <= interval_s <= MAX_INTERVAL_S:
        expected = f"the exposure, {exposure_s:g} s, to {MAX_INTERVAL_S:g} s"
        raise BadInput("interval is out of range", expected=expected, got=f"{interval_s:g} s")
    times_s = np.asarray(unix_s(start) + interval_s * np.arange(images, dtype=np.float64))
    quaternions = motion(times_s)
    known = np.isfinite(quaternions).all(axis=1)
    if not known.all():
        raise BadInput(
            f"no attitude at {_iso(times_s[~known][0])}",
            expected="attitudes for the whole sequence, less than ten minutes apart",
            got=f"attitudes for {int(known.sum())} of {images} images",
            hint="choose another start, fewer images or a shorter interval",
        )
    rates = _rates(motion, times_s, quaternions)
    return [
        RenderMoment(datetime.fromtimestamp(s, UTC), q, rate)
        for s, q, rate in zip(times_s, quaternions, rates, strict=True)
    ]


def _rates(motion: Motion, times_s: Array, quaternions: Array) -> Array:
    """Return (n, 3) rates in camera axes between half a second before and after each time. At the end of the known attitudes
    one side is used, and zero if there is none."""
    before, after = motion(times_s - RATE_STEP_S), motion(times_s + RATE_STEP_S)
    sides = np.isfinite(before[:, :1]).astype(float) + np.isfinite(after[:, :1])
    first, last = (np.where(np.isfinite(q), q, quaternions) for q in (before, after))
    return np.asarray(-turn_between(first, last) / (RATE_STEP_S * np.maximum(sides, 1.0)))


def _iso(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")


def draw_sequence(
    profile: CameraProfile, request: RenderRequest, moments: list[RenderMoment]
) -> Iterator[tuple[RenderMoment, Rendered]]:
    """Return an iterator over the rendered images. ``request``: attitude and rate are replaced by those of each moment, and
    image k, counted from 0, has the seed ``request.seed`` + k. Raises BadInput at once if an image moves too fast."""
    exposure_s = profile.sensor.exposure_s if request.exposure_s is None else request.exposure_s
    for moment in moments:
        if longest_trail_s(profile.camera, profile.sensor, moment.rate_rad_s) < exposure_s:
            speed = float(np.degrees(np.linalg.norm(moment.rate_rad_s)))
            raise BadInput(
                f"the camera rotates too fast at {moment.at.isoformat(timespec='seconds')}",
                expected="trails that can be drawn",
                got=f"{speed:.3g}°/s with an exposure of {exposure_s:g} s",
                hint="use a shorter exposure or a slower motion",
            )

    def images() -> Iterator[tuple[RenderMoment, Rendered]]:
        for k, moment in enumerate(moments):
            x, y, z = (float(v) for v in moment.rate_rad_s)
            attitude = matrix_from_quaternion(moment.quaternion)
            one = replace(request, cam_from_icrs=attitude, rate_rad_s=(x, y, z), seed=request.seed + k)
            yield moment, draw(profile, one)

    return images()
