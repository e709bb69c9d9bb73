"""Smooth motion of one object over the sky, fitted to its light sources in several frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc

from gss.domain.angles import Array
from gss.pipeline.moving.spots import FrameSpots, attitude_at, tangent

GATE_SIGMA = 4.0
MIN_GATE_PX = 0.5
MIN_PROBABILITY = 1e-4
MAX_DEGREE = 3
ACCELERATION = 1.0
"""Standard deviation of the angular acceleration in units of rate². An object that passes at a constant velocity
reaches at most about twice this value."""
TRAIL_PX, TRAIL_SHARE = 2.5, 0.25


class Hit(NamedTuple):
    """Reference to a source: its row in a frame."""

    frame: int
    row: int


@dataclass(frozen=True)
class SkyMotion:
    """Fitted motion: polynomial in time in the tangent plane at ``centre`` (3,), spanned by ``plane`` (2, 3) towards
    east and north. ``start_s``, ``span_s``: mean and half span of the times ``knots_s`` (n,). ``coefficients`` (degree
    + 1, 2) of powers of the time in half spans, ``covariance`` (degree + 1, degree + 1) of each axis; ``residual_rad``
    (n, 2); ``velocity`` (n, 3) at the sources, rad/s, tangent to the sphere."""

    centre: Array
    plane: Array
    start_s: float
    span_s: float
    coefficients: Array
    covariance: Array
    knots_s: Array
    residual_rad: Array
    chi2: float
    freedom: int
    velocity: Array

    @property
    def rate_rad_s(self) -> Array:
        """Return the (2,) rate at the middle, east and north."""
        return np.asarray(self.coefficients[1] / self.span_s)

    @property
    def rate_covariance(self) -> Array:
        """Return the (2, 2) covariance of the rate."""
        return np.asarray(np.eye(2) * self.covariance[1, 1] / self.span_s**2)

    @property
    def sound(self) -> bool:
        """True if the residuals are consistent with their errors."""
        return self.freedom <= 0 or bool(gammaincc(self.freedom / 2, self.chi2 / 2) > MIN_PROBABILITY)

    def covers(self, time_s: float) -> bool:
        """True if the time is within the fitted span or one step beside it."""
        step_s = 2 * self.span_s / (len(self.knots_s) - 1)
        return abs(time_s - self.start_s) <= self.span_s + 1.5 * step_s

    @property
    def slack_rad(self) -> float:
        """Return the position error at one span from the middle that is caused by an unknown acceleration. Two sources
        cannot determine an acceleration."""
        return float(ACCELERATION * np.sum(self.rate_rad_s**2) * self.span_s**2)

    def at(self, time_s: float) -> tuple[Array, float]:
        """Return the (3,) direction at a time, and its standard deviation including the neglected next power of time."""
        x = (time_s - self.start_s) / self.span_s
        powers = x ** np.arange(len(self.coefficients))
        direction = self.centre + (powers @ self.coefficients) @ self.plane
        spread = float(powers @ self.covariance @ powers)
        speed = float(np.hypot(*self.rate_rad_s))
        # The next power is limited by the geometry of a straight pass, in which each derivative has one more factor of
        # the rate.
        nodes = np.sort(np.abs(time_s - self.knots_s))[: len(self.coefficients)]
        model_error_rad = ACCELERATION * speed ** len(self.coefficients) * float(np.prod(nodes)) / 2
        return np.asarray(direction / np.linalg.norm(direction)), float(
            np.hypot(np.sqrt(max(spread, 0.0)), model_error_rad)
        )


def fit_motion(frames: Sequence[FrameSpots], hits: Sequence[Hit]) -> SkyMotion | None:
    """Fit the polynomial of the lowest degree that agrees with the errors. From degree 2 on, there must be at least one
    more source than coefficients. None if the sources are too far apart for one tangent plane."""
    times = np.array([frames[h.frame].view.time_s for h in hits])
    icrs = np.array([frames[h.frame].icrs[h.row] for h in hits])
    covariance = np.array([frames[h.frame].covariance_rad2[h.row] for h in hits])
    centre = icrs.mean(axis=0)
    centre /= np.linalg.norm(centre)
    height = icrs @ centre
    if height.min() < 0.5:
        return None
    plane = tangent(centre[None])[0]
    plane_position = icrs @ plane.T / height[:, None]
    # Gate and fit use the same error for both axes. For a trail, this is the larger error, which is along the trail.
    sigma: Array = np.sqrt(np.linalg.eigvalsh(covariance)[:, 1])
    middle, span = float(times.mean()), float(max(np.ptp(times) / 2, 1e-6))
    best = None
    for degree in range(1, MAX_DEGREE + 1):
        if degree > 1 and len(hits) < degree + 2:
            break
        best = _fitted(times, plane_position, sigma, degree, centre, plane, middle, span)
        if best.sound:
            break
    return best


def _fitted(
    times: Array, place: Array, sigma: Array, degree: int, centre: Array, plane: Array, middle: float, span: float
) -> SkyMotion:
    x = (times - middle) / span
    design = x[:, None] ** np.arange(degree + 1)
    weighted = design / sigma[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted + 1e-12 * np.eye(degree + 1))
    coefficients = covariance @ (weighted.T @ (place / sigma[:, None]))
    residual: Array = np.asarray(place - design @ coefficients, float)
    slope = np.arange(degree + 1) * x[:, None] ** np.maximum(np.arange(degree + 1) - 1, 0) / span
    return SkyMotion(
        centre,
        plane,
        middle,
        span,
        coefficients,
        np.asarray(covariance),
        times,
        residual,
        float(((residual / sigma[:, None]) ** 2).sum()),
        2 * (len(times) - degree - 1),
        slope @ coefficients @ plane,
    )


def gate_rad(frame: FrameSpots, rows: NDArray[np.intp], sigma_rad: float) -> Array:
    """Return the (n,) distances within which sources are assigned to a prediction with error ``sigma_rad``."""
    star_variance = np.linalg.eigvalsh(frame.covariance_rad2[rows])[:, 1]
    min_gate_rad = MIN_GATE_PX * frame.view.camera.pixel_rad
    return np.asarray(np.maximum(GATE_SIGMA * np.sqrt(star_variance + sigma_rad**2), min_gate_rad))


def trail_agrees(frames: Sequence[FrameSpots], hits: Sequence[Hit], motion: SkyMotion) -> bool:
    """True if most trails have the length and direction expected from the motion and the camera's rotation in one
    exposure. Frames with unknown camera rate are ignored."""
    compared, agreeing = 0, 0
    for number, hit in enumerate(hits):
        frame = frames[hit.frame]
        view = frame.view
        if view.rate_rad_s is None:
            continue
        half_s = view.exposure_s / 2
        moved = motion.velocity[number] * half_s
        ends = [
            view.camera.project(((frame.icrs[hit.row] + sign * moved) @ attitude_at(view, sign * half_s).T)[None])[0]
            for sign in (-1, 1)
        ]
        expected = ends[1] - ends[0]
        length, shortest = float(np.hypot(*expected)), TRAIL_PX * frame.star_sigma_px
        trail = frame.trail_px[hit.row]
        if not trail.any():  # a trail that was not significant
            compared, agreeing = compared + 1, agreeing + (length <= max(shortest, frame.longest_px[hit.row]))
            continue
        off = min(float(np.hypot(*(trail - expected))), float(np.hypot(*(trail + expected))))
        compared += 1
        agreeing += off <= max(shortest, TRAIL_SHARE * length)
    return compared == 0 or agreeing > 0.6 * compared
