"""The sensor's result for one frame, collected from its packets and converted to pipeline types."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gss.domain.angles import ARCSEC_RAD
from gss.domain.camera import Camera
from gss.domain.results import Attitude, Centroids, Matches, Outcome, SolveResult
from gss.domain.stars import StarTable
from gss.pipeline.chains.apriori import PriorState

Rows = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class OnboardRecord:
    """The received packets of one frame. ``hip_of_row``: Hipparcos numbers of the active bank's rows, None if the ground does not
    have the content of that bank. ``icrs_of_hip``: stars with their positions. ``prior``: the sensor's prior knowledge when it
    calculated the attitude. ``detected``: other values in the packet of the centroid list."""

    frame_number: int
    centroids: Rows = ()
    matches: Rows = ()
    attitude: Mapping[str, Any] | None = None
    hip_of_row: Sequence[int] | None = None
    icrs_of_hip: StarTable | None = None
    prior: PriorState = field(default_factory=PriorState)
    detected: Mapping[str, Any] = field(default_factory=dict)

    def with_packet(self, packet: str, values: Mapping[str, Any], items: Rows) -> OnboardRecord:
        """Return the record with an additional packet. A new centroid list removes earlier matches and attitude."""
        if packet == "centroids":
            return replace(self, centroids=items, matches=(), attitude=None, detected=values)
        if packet == "matches":
            return replace(self, matches=items, attitude=None)
        return replace(self, attitude=values)


def onboard_result(record: OnboardRecord, camera: Camera, chain: str) -> SolveResult:
    """Convert the record to a result in the form of a ground result. Values that the packets do not contain are empty or NaN."""
    centroids = _centroids(record.centroids)
    attitude = _attitude(record.attitude)
    matches = _matches(record, camera, centroids, attitude)
    reason = ""
    if attitude is None:
        reason = str(
            (record.attitude or {}).get("reason") or "the sensor has not calculated an attitude for this frame"
        )
    notes = (
        ()
        if record.hip_of_row is not None or not record.matches
        else ("the content of the active bank is not available on the ground",)
    )
    return SolveResult(
        chain=chain,
        outcome=Outcome.NONE if attitude is None else Outcome.SOLVED,
        reason=reason,
        camera=camera,
        regions=(),
        centroids=centroids,
        matches=matches,
        attitude=attitude,
        false_match_probability=math.nan,
        notes=notes,
    )


def _centroids(rows: Rows) -> Centroids:
    def column(name: str) -> Any:
        return np.array([float(row[name]) for row in rows], float)

    n = len(rows)
    area = np.array([int(row["area_px"]) for row in rows], np.int32)
    return Centroids(column("col_px"), column("row_px"), column("flux_dn"), column("peak_dn"), area, np.full(n, np.nan))


def _attitude(values: Mapping[str, Any] | None) -> Attitude | None:
    if values is None or values.get("outcome") != "solved":
        return None
    quaternion = np.array([float(values[f"quaternion_{axis}"]) for axis in "xyzw"])
    cross_rad = float(values.get("sigma_cross_arcsec", math.nan)) * ARCSEC_RAD
    roll_rad = float(values.get("sigma_roll_arcsec", math.nan)) * ARCSEC_RAD
    return Attitude(quaternion, np.diag([cross_rad**2, cross_rad**2, roll_rad**2]))


def _matches(record: OnboardRecord, camera: Camera, centroids: Centroids, attitude: Attitude | None) -> Matches | None:
    rows, hips = [], []
    for row in record.matches:
        number = int(row["star"])
        hip = number if record.hip_of_row is None else _at(record.hip_of_row, number)
        if 0 <= int(row["centroid"]) < len(centroids) and hip is not None:
            rows.append(row)
            hips.append(hip)
    if not rows:
        return None
    index = np.array([int(row["centroid"]) for row in rows], np.int32)
    hip_array = np.array(hips, np.int32)
    residual = np.full((len(rows), 2), np.nan)
    if attitude is not None and record.icrs_of_hip is not None:
        position = {int(h): k for k, h in enumerate(record.icrs_of_hip.hip)}
        has_position = np.array([h in position for h in hips])
        if has_position.any():
            icrs = record.icrs_of_hip.icrs[[position[h] for h in hips if h in position]]
            residual[has_position] = centroids.pixels[index[has_position]] - camera.project(
                icrs @ attitude.cam_from_icrs.T
            )
    return Matches(index, hip_array, np.array([float(row["weight"]) for row in rows]), residual)


def _at(values: Sequence[int], index: int) -> int | None:
    return int(values[index]) if 0 <= index < len(values) else None
