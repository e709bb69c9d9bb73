"""Matched vectors as Sunsat's star sensor passes them to the attitude control (Jacobs 1995 §3.4, §7.5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gss.device.simulator.images import StoredFrame
from gss.device.simulator.reports import Report, Row
from gss.domain.results import Outcome, SolveResult
from gss.instruments.dictionary.definitions import Value
from gss.pipeline.chains.apriori import KnownOrbit
from gss.pipeline.chains.onboard import Detection, OnboardSolution, Work
from gss.pipeline.chains.sunsat_frames import attitude_angles_rad
from gss.pipeline.chains.sunsat_vectors import matched_vectors

J2000_UTC_S, DAY_S = 946_728_000.0, 86_400.0
"""2000-01-01 12:00 in seconds since 1970; the difference of about one minute between UTC and TT does not affect a
velocity."""
MAX_VECTORS = 255


def no_vectors(frame: StoredFrame) -> Report:
    """Return the packet "matched_vectors" without vectors, which the attitude control receives if there is no attitude
    (Jacobs 1995 §4.1.7)."""
    angles: dict[str, Value] = dict.fromkeys(("roll_deg", "pitch_deg", "yaw_deg"), float("nan"))
    return "matched_vectors", {"frame_number": frame.number, "frame_time_s": frame.time_s} | angles, {"items": []}


def vector_report(
    frame: StoredFrame,
    work: Work,
    detection: Detection,
    solution: OnboardSolution,
    row: NDArray[np.integer],
    orbit: KnownOrbit,
    utc_s: float,
) -> Report:
    """Return the packet "matched_vectors" of a solution with an attitude.

    ``row``: (n,) catalogue row per centroid. Roll, pitch and yaw belong to the attitude of the solution.
    """
    if solution.attitude is None or solution.matches is None:
        return no_vectors(frame)
    result = SolveResult(
        "",
        Outcome.SOLVED,
        "",
        work.camera,
        detection.regions,
        detection.centroids,
        solution.matches,
        solution.attitude,
        solution.false_match_probability,
    )
    elements = orbit.elements_at(frame.time_s)
    angles_rad = attitude_angles_rad(solution.attitude.cam_from_icrs, elements)
    days = (utc_s - J2000_UTC_S) / DAY_S
    vectors = matched_vectors(result, elements, angles_rad, days, orbit.speed_m_s)
    # Stars that only confirm the match can be fainter than the stars used for matching. Such stars have no catalogue
    # row and are not sent.
    named = np.concatenate([row, np.full(len(detection.centroids) - len(row), -1)])
    stars = named[solution.matches.centroid]
    items: list[Row] = [
        {
            "star": int(stars[i]),
            **dict(zip(("body_x", "body_y", "body_z"), map(float, vectors.observed_body[i]), strict=True)),
            **dict(zip(("orbit_x", "orbit_y", "orbit_z"), map(float, vectors.reference_orbit[i]), strict=True)),
        }
        for i in range(min(len(vectors), MAX_VECTORS))
        if stars[i] >= 0
    ]
    roll, pitch, yaw = np.degrees(angles_rad)
    values: dict[str, Value] = {"frame_number": frame.number, "frame_time_s": frame.time_s}
    values |= {"roll_deg": float(roll), "pitch_deg": float(pitch), "yaw_deg": float(yaw)}
    return "matched_vectors", values, {"items": items}
