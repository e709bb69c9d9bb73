"""Convert results of the sensor to telemetry packets, in the dictionary's units."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.device.simulator.images import StoredFrame
from gss.domain.angles import ARCSEC_RAD
from gss.domain.frames import ra_dec_roll_rad
from gss.domain.results import Attitude, Centroids, Truth
from gss.domain.rotation import matrix_from_quaternion
from gss.instruments.dictionary.definitions import Value
from gss.pipeline.chains.onboard import Detection, Matched

Row = Mapping[str, Value]
Report = tuple[str, dict[str, Value], dict[str, list[Row]]]
"""A telemetry packet to send: name, values, lists."""


@dataclass
class Timing:
    """Durations of the last iteration in milliseconds."""

    capture_ms: float = 0.0
    transfer_ms: float = 0.0
    detect_ms: float = 0.0
    match_ms: float = 0.0
    attitude_ms: float = 0.0


def centroid_report(frame_number: int, detection: Detection) -> Report:
    """Return the packet "centroids"."""
    values: dict[str, Value] = {
        "frame_number": frame_number,
        "regions_invalid": min(255, detection.invalid),
        "background_dn": float(detection.black_dn),
    }
    return "centroids", values, {"items": _centroid_rows(detection.centroids)}


def _centroid_rows(centroids: Centroids) -> list[Row]:
    return [
        {
            "col_px": float(centroids.col_px[i]),
            "row_px": float(centroids.row_px[i]),
            "flux_dn": float(centroids.flux_dn[i]),
            "peak_dn": int(centroids.peak_dn[i]),
            "area_px": int(centroids.area_px[i]),
        }
        for i in range(len(centroids))
    ]


def match_report(frame_number: int, matching: Matched) -> Report:
    """Return the packet "matches": the stars used for the attitude, or the verified stars before the attitude is
    known."""
    rows: list[Row] = [
        {"centroid": int(i), "star": int(matching.row[i]), "weight": float(matching.weight[i])}
        for i in matching.selected
    ]
    return "matches", {"frame_number": frame_number}, {"items": rows}


def attitude_report(frame_values: Mapping[str, Value], attitude: Attitude | None, reason: str) -> Report:
    """Return the packet "attitude". ``frame_values``: frame, mode and counts."""
    values = dict(frame_values)
    values["outcome"] = "solved" if attitude else "none"
    values["reason"] = reason.encode()[:200].decode(errors="ignore")
    sigma_rad = attitude.sigma_rad if attitude else (float("nan"), float("nan"))
    values["sigma_cross_arcsec"], values["sigma_roll_arcsec"] = (s / ARCSEC_RAD for s in sigma_rad)
    return "attitude", values | pose_values(attitude.quaternion if attitude else None), {}


def timing_report(iteration: int, frame_number: int, timing: Timing) -> Report:
    """Return the packet "timing"."""
    values: dict[str, Value] = {"iteration": iteration, "frame_number": frame_number}
    return "timing", values | timing_values(timing), {}


def frame_report(frame: StoredFrame) -> Report:
    """Return the packet "frame_info"."""
    rows, columns = frame.pixels.shape
    values: dict[str, Value] = {
        "frame_number": frame.number,
        "slot": frame.slot,
        "source": frame.source,
        "exposure_ms": frame.exposure_ms,
        "frame_time_s": frame.time_s,
        "columns": columns,
        "rows": rows,
        "bits": frame.bits,
        "mode": frame.mode,
        "sha256": hashlib.sha256(frame.data).digest(),
    }
    return "frame_info", values, {}


def timing_values(timing: Timing) -> dict[str, Value]:
    """Return the durations in whole milliseconds, as on the wire."""
    return {name: min(0xFFFF, round(value)) for name, value in vars(timing).items()}


def pose_values(quaternion: NDArray[np.float64] | None) -> dict[str, Value]:
    """Return quaternion, boresight and roll in degrees; NaN without an attitude."""
    names = ("quaternion_x", "quaternion_y", "quaternion_z", "quaternion_w", "ra_deg", "dec_deg", "roll_deg")
    if quaternion is None:
        return dict.fromkeys(names, float("nan"))
    angles = np.degrees(ra_dec_roll_rad(matrix_from_quaternion(quaternion)))
    return dict(zip(names, map(float, (*quaternion, *angles)), strict=True))


def truth_report(frame_number: int, truth: Truth) -> Report:
    """Return the packet "frame_truth", which real devices do not send."""
    return "frame_truth", {"frame_number": frame_number} | pose_values(truth.quaternion), {}
