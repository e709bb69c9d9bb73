"""Spacecraft with several heads as responses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

from gss.api.present.alarms import alarm
from gss.api.schemas.heads import (
    BodyAttitudeOut,
    FusedOut,
    HeadHistoryOut,
    HeadOut,
    HeadPairOut,
    HeadsOut,
    MisalignmentOut,
    Vector,
)
from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.frames import ra_dec_roll_rad
from gss.domain.rotation import matrix_from_quaternion
from gss.operations.heads.head_watch import UPPER_3, HeadState, SpacecraftState
from gss.operations.heads.history import StoredPair
from gss.operations.heads.mountings import HOUR_S, HeadMounting, SpacecraftSetup
from gss.operations.heads.tracker import HeadsResult, PairResult
from gss.operations.telemetry.alarm_text import HEADS, AlarmView
from gss.pipeline.heads.misalignment import Misalignment
from gss.pipeline.track.cameras_together import BodyAttitude
from gss.store.models import FusedRow

NOT_COMPARED = (
    "The heads are not compared at present, because the server has a single unit or the spacecraft was just changed."
)


def heads(
    setup: SpacecraftSetup, state: SpacecraftState | None, served: Sequence[str], alarms: Sequence[AlarmView]
) -> HeadsOut:
    """Return a spacecraft. ``state``: None if its heads are not compared; ``served``: units of this server; ``alarms``:
    open alarms."""
    result = state.result if state else None
    states = {head.unit: head for head in state.heads} if state else {}
    state_name = "unknown" if state is None or state.verdict.state is None else state.verdict.state
    if setup.problem:
        state_name = "warning"
    return HeadsOut(
        id=setup.id,
        name=setup.name,
        source=setup.source,
        tolerance_s=setup.tolerance_s,
        stale_s=setup.stale_s,
        largest_rate_deg_s=_over(setup.largest_rate_rad_s, math.radians(1)),
        misalignment_limit_arcsec=_over(setup.misalignment_limit_rad, ARCSEC_RAD),
        drift_limit_arcsec_h=_over(setup.drift_limit_rad_s, ARCSEC_RAD / HOUR_S),
        user=setup.user,
        changed=setup.changed,
        state="ok" if state_name == "ok" else "unknown" if state_name == "unknown" else "warning",
        text=setup.problem or (state.verdict.text if state else NOT_COMPARED),
        heads=[_head(head, states.get(head.unit), head.unit in served, result) for head in setup.heads],
        fused=None if result is None else _fused(result),
        pairs=[] if result is None else [_pair(result.time_s, pair) for pair in result.pairs],
        alarms=[alarm(v) for v in alarms if v.row.packet == HEADS and v.row.field.startswith(f"{setup.name}: ")],
    )


def history(points: Sequence[StoredPair]) -> HeadHistoryOut:
    """Return the stored comparisons of heads."""
    return HeadHistoryOut(points=[stored_pair(point) for point in points])


def stored_pair(point: StoredPair) -> HeadPairOut:
    """Return one stored comparison of two heads."""
    row = point.row
    return HeadPairOut(
        **vars(_misalignment(point.misalignment, point.sigma_rad, point.drift_sigma_rad_s)),
        reference=row.reference,
        unit=row.unit,
        at=row.at,
        angle_arcsec=row.angle_rad / ARCSEC_RAD,
        angle_sigma_arcsec=row.angle_sigma_rad / ARCSEC_RAD,
        boresight_arcsec=row.boresight_rad / ARCSEC_RAD,
        boresight_sigma_arcsec=row.boresight_sigma_rad / ARCSEC_RAD,
        chi2=row.chi2,
    )


def stored_fused(row: FusedRow) -> FusedOut:
    """Return one stored fused attitude."""
    covariance = np.zeros((3, 3))
    covariance[UPPER_3] = row.covariance
    covariance = covariance + np.triu(covariance, 1).T
    return FusedOut(
        **vars(_attitude(BodyAttitude(np.array(row.quaternion), covariance))),
        at=row.at,
        units=row.units,
        covariance_arcsec2=_triangle(covariance),
        chi2=row.chi2,
        freedom=row.freedom,
        probability=row.probability,
    )


def _head(head: HeadMounting, state: HeadState | None, served: bool, result: HeadsResult | None) -> HeadOut:
    cross, roll = head.usual_rad or (None, None)
    measured = result.attitudes.get(head.unit) if result else None
    missing = result.missing.get(head.unit, "") if result else ""
    problem = (state.problem or missing) if state else NOT_COMPARED
    x, y, z, w = (float(q) for q in head.body_from_cam)
    return HeadOut(
        unit=head.unit,
        mounting_deg=head.turns_deg,
        body_from_cam=(x, y, z, w),
        boresight=_vector(head.boresight),
        sigma_arcsec=head.sigma_rad / ARCSEC_RAD,
        sigma_cross_arcsec=_over(cross, ARCSEC_RAD),
        sigma_roll_arcsec=_over(roll, ARCSEC_RAD),
        served=served,
        fresh=state is not None and state.fresh,
        age_s=state.age_s if state else None,
        problem=problem if served else "this server has no such unit",
        attitude=None if measured is None else _attitude(measured),
    )


def _attitude(attitude: BodyAttitude) -> BodyAttitudeOut:
    ra, dec, roll = (math.degrees(float(a)) for a in ra_dec_roll_rad(matrix_from_quaternion(attitude.quaternion)))
    x, y, z, w = (float(q) for q in attitude.quaternion)
    sigma = np.sqrt(np.diag(attitude.covariance_rad2)) / ARCSEC_RAD
    return BodyAttitudeOut(quaternion=(x, y, z, w), ra_deg=ra, dec_deg=dec, roll_deg=roll, sigma_arcsec=_vector(sigma))


def _fused(result: HeadsResult) -> FusedOut:
    fused, agreement = result.fused, result.fused.agreement
    return FusedOut(
        **vars(_attitude(BodyAttitude(fused.quaternion, fused.covariance_rad2))),
        at=datetime.fromtimestamp(result.time_s, UTC),
        units=list(result.attitudes),
        covariance_arcsec2=_triangle(fused.covariance_rad2),
        chi2=None if agreement is None else agreement.chi2,
        freedom=None if agreement is None else agreement.freedom,
        probability=None if agreement is None else agreement.probability,
    )


def _pair(time_s: float, pair: PairResult) -> HeadPairOut:
    difference = pair.difference
    return HeadPairOut(
        **vars(_misalignment(pair.misalignment, pair.sigma_rad, pair.drift_sigma_rad_s)),
        reference=pair.reference,
        unit=pair.unit,
        at=datetime.fromtimestamp(time_s, UTC),
        angle_arcsec=difference.angle_rad / ARCSEC_RAD,
        angle_sigma_arcsec=difference.angle_sigma_rad / ARCSEC_RAD,
        boresight_arcsec=difference.boresight_rad / ARCSEC_RAD,
        boresight_sigma_arcsec=difference.boresight_sigma_rad / ARCSEC_RAD,
        chi2=difference.agreement.chi2,
    )


def _misalignment(estimate: Misalignment, sigma_rad: Array, drift_sigma_rad_s: Array) -> MisalignmentOut:
    hour = HOUR_S / ARCSEC_RAD
    return MisalignmentOut(
        misalignment_arcsec=_vector(estimate.vector_rad / ARCSEC_RAD),
        misalignment_sigma_arcsec=_vector(sigma_rad / ARCSEC_RAD),
        drift_arcsec_h=_vector(estimate.drift_rad_s * hour),
        drift_sigma_arcsec_h=_vector(drift_sigma_rad_s * hour),
        samples=estimate.samples,
        restarts=estimate.restarts,
    )


def _triangle(covariance_rad2: Array) -> tuple[float, float, float, float, float, float]:
    a, b, c, d, e, f = (float(v) for v in covariance_rad2[UPPER_3] / ARCSEC_RAD**2)
    return a, b, c, d, e, f


def _vector(values: Array) -> Vector:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _over(value: float | None, unit: float) -> float | None:
    return None if value is None else value / unit
