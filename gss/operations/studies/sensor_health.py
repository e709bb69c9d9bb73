"""Analyses the health of a sensor over a mission from stored frames or files, and proposes a calibration."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import Any

import numpy as np

from gss.device.table_use import calibration_values
from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.json_object import JsonObject
from gss.operations.frames.frames import Pixels
from gss.operations.frames.solve import Solver
from gss.operations.studies.analyse import DEEPER_MAG, AnalysisResult, AnalysisRun, subject_of
from gss.operations.studies.health_sheet import health_report
from gss.operations.studies.night_frames import ProgressCallback, Shot, apparent_stars
from gss.operations.studies.reported import temperature_near
from gss.orbit.read_orbit import orbit_covering
from gss.orbit.trajectory import Trajectory, earth_fixed_km
from gss.pipeline.calibration.plain_values import as_record
from gss.pipeline.health.frame_figures import HealthFrame
from gss.pipeline.health.mission import mission_health
from gss.pipeline.health.proposal import Proposal, proposed

GroundPlaces = Callable[[Array], Array]
"""Function that returns (n, 2) latitude and longitude in radians below the camera at (n,) Unix seconds; NaN if
unknown."""


@dataclass(frozen=True)
class Surroundings:
    """Conditions of the frames. ``temperature``: Unix seconds and °C of the unit; ``places``: positions below the
    camera. Both are None if unknown."""

    temperature: tuple[Array, Array] | None = None
    places: GroundPlaces | None = None


def places_below(orbit_at: Callable[[float], Trajectory | None]) -> GroundPlaces:
    """Return a function for the positions below a spacecraft. ``orbit_at``: returns the orbit at a Unix time, None if
    unknown."""

    def places(times_s: Array) -> Array:
        positions = np.full((len(times_s), 2), np.nan)
        for k, at_s in enumerate(times_s.tolist()):
            orbit = orbit_at(at_s)
            if orbit is not None:
                x, y, z = earth_fixed_km(orbit, np.array([at_s]))[0]
                positions[k] = np.arctan2(z, np.hypot(x, y)), np.arctan2(y, x)
        return positions

    return places


def orbit_within(trajectories: Sequence[Trajectory]) -> Callable[[float], Trajectory | None]:
    """Return a function that returns the nearest of the given orbits at a Unix time; None if no orbit covers the
    time."""
    return lambda at_s: orbit_covering(trajectories, datetime.fromtimestamp(at_s, UTC))


def sensor_health(
    solver: Solver, run: AnalysisRun, surroundings: Surroundings, progress: ProgressCallback
) -> AnalysisResult:
    """Return the health analysis of the solved frames of a run. Raises BadInput with fewer than 30 solved frames."""
    health = mission_health(health_frames(solver, run, surroundings), run.profile.camera, run.profile.sensor, progress)
    proposal = proposed(health, run.profile)
    figures = dict(as_record(health)) | {"proposal": proposal_record(proposal)}
    return AnalysisResult("health", health_report(health, proposal, run.profile, subject_of(run)), figures)


def health_frames(solver: Solver, run: AnalysisRun, surroundings: Surroundings) -> list[HealthFrame]:
    """Return the shots of a run with their results, stars, temperatures and positions."""
    sensor = run.profile.sensor
    times = np.array([s.taken.timestamp() for s in run.shots])
    temperatures_c = np.full(len(times), np.nan)
    if surroundings.temperature is not None:
        temperatures_c = temperature_near(times, *surroundings.temperature)
    places = np.full((len(times), 2), np.nan) if surroundings.places is None else surroundings.places(times)
    limit_mag = sensor.faint_limit_mag + DEEPER_MAG
    return [
        HealthFrame(
            shot.name,
            float(times[k]),
            sensor.exposure_s if shot.exposure_s is None else shot.exposure_s,
            partial(_lit_pixels, shot, run.profile),
            result,
            apparent_stars(solver, shot).brighter_than(limit_mag),
            float(temperatures_c[k]),
            (float(places[k, 0]), float(places[k, 1])) if np.isfinite(places[k]).all() else None,
        )
        for k, (shot, result) in enumerate(zip(run.shots, run.results, strict=True))
    ]


def _lit_pixels(shot: Shot, profile: CameraProfile) -> Pixels:
    """Return the (rows, columns) light-sensitive pixels of a shot."""
    return profile.sensor.dark_columns.split(shot.pixels(), profile.camera.columns)[0]


def proposal_record(proposal: Proposal) -> JsonObject:
    """Return a proposed calibration as values of the sensor's table and bad pixels, which is the form of stored
    calibrations."""
    return {
        "values": dict(calibration_values(proposal.profile)),
        "changes": as_record(proposal.changes),
        "bad": proposal.bad.tolist(),
        "left_out": list(proposal.left_out),
    }


def bad_pixel_table(health: Mapping[str, Any]) -> bytes:
    """Return the warm pixels of a stored health analysis as CSV."""
    lines = ["col,row,course,onset_unix_s,onset_low_s,onset_high_s,first_e_s,now_e_s,half_life_days,bad_now"]
    bad_pixels = {(c, r) for c, r in health["proposal"]["bad"]}
    for pixel in health["pixels"]:
        onset = pixel["onset_s"] or {}
        life = (pixel["half_life_s"] or {}).get("value")
        cells = [
            pixel["col"],
            pixel["row"],
            pixel["shape"],
            *(onset.get(k) for k in ("value", "low", "high")),
            *(_rounded(pixel[k]["value"]) for k in ("first_e_s", "now_e_s")),
            None if life is None else f"{life / 86_400:.3g}",
            int((pixel["col"], pixel["row"]) in bad_pixels),
        ]
        lines.append(",".join("" if c is None else str(c) for c in cells))
    return ("\n".join(lines) + "\n").encode()


def _rounded(value: float | None) -> str | None:
    """Return a number with four digits; None if it could not be determined."""
    return None if value is None else f"{value:.4g}"
