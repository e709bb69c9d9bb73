"""The sensor's report on a frame and the sensor's prior knowledge, as JSON values. They are stored with the result, so
the frame can be replayed at any time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from gss.domain.stars import StarTable
from gss.operations.frames.onboard_results import OnboardRecord
from gss.operations.telemetry.value_format import plain
from gss.pipeline.chains.apriori import Apriori, KnownOrbit, PriorState, TimedAttitude
from gss.store.models import Frame

OWN = ("number", "profile", "exposure_s", "bank_sha256", "parameters")
"""Columns of a frame with the values that the sensor used. The row of an uploaded frame has different values."""


def reported_of(record: OnboardRecord, frame: Frame) -> dict[str, object]:
    """Return a record as plain values."""
    return {
        "frame": {name: getattr(frame, name) for name in OWN},
        "detected": _plain(record.detected),
        "centroids": [_plain(row) for row in record.centroids],
        "matches": [_plain(row) for row in record.matches],
        "attitude": None if record.attitude is None else _plain(record.attitude),
        "prior": _prior(record.prior),
    }


def record_from(
    reported: Mapping[str, Any], hip_of_row: Sequence[int] | None = None, stars: StarTable | None = None
) -> OnboardRecord:
    """Restore the record from the values of :func:`reported_of`."""
    return OnboardRecord(
        int(reported["frame"]["number"] or 0),
        reported["centroids"],
        reported["matches"],
        reported["attitude"],
        hip_of_row,
        stars,
        _prior_from(reported["prior"]),
        reported["detected"],
    )


def frame_as_used(frame: Frame, reported: Mapping[str, Any]) -> Frame:
    """Return a copy of the frame's row with the values that the sensor used."""
    values = {column.name: getattr(frame, column.name) for column in Frame.__table__.columns}
    return Frame(**(values | dict(reported["frame"])))


def _plain(values: Mapping[str, Any]) -> dict[str, object]:
    return {name: plain(value) for name, value in values.items()}


def _prior(prior: PriorState) -> dict[str, object]:
    return {
        "series": [
            {"quaternion": _listed(a.quaternion), "time_s": None if math.isnan(a.time_s) else a.time_s}
            for a in prior.series
        ],
        "failed": prior.failed,
        "commanded": _listed(prior.commanded),
        "commanded_radius_rad": prior.commanded_radius_rad,
        "orbit": None if prior.orbit is None else asdict(prior.orbit),
        "apriori": None if prior.apriori is None else asdict(prior.apriori),
    }


def _listed(quaternion: Any) -> list[float] | None:
    return None if quaternion is None else [float(v) for v in quaternion]


def _prior_from(prior: Mapping[str, Any]) -> PriorState:
    def array(values: Any) -> Any:
        return None if values is None else np.array(values, float)

    if "series" in prior:
        series = tuple(
            TimedAttitude(array(a["quaternion"]), math.nan if a["time_s"] is None else float(a["time_s"]))
            for a in prior["series"]
        )
    else:
        # Results that earlier versions stored have attitudes without times. These attitudes are treated as equally
        # spaced in time.
        listed = [prior["quaternion"], *prior["earlier"]] if prior["quaternion"] is not None else []
        series = tuple(TimedAttitude(array(q), math.nan) for q in listed)
    return PriorState(
        series,
        bool(prior.get("failed", False)),
        array(prior["commanded"]),
        float(prior["commanded_radius_rad"]),
        None if prior["orbit"] is None else KnownOrbit(**prior["orbit"]),
        None if prior["apriori"] is None else Apriori(**prior["apriori"]),
    )
