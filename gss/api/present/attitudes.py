"""Attitude comparisons as responses."""

from __future__ import annotations

import math

from gss.api.schemas.attitudes import AttitudeComparisonOut, ComparedAttitudeOut
from gss.domain.angles import ARCSEC_RAD, Array
from gss.operations.frames.attitude_exchange import AttitudeComparison


def comparison(result: AttitudeComparison) -> AttitudeComparisonOut:
    """Return a comparison with angles in arcseconds and degrees."""
    x, y, z, w = (float(q) for q in result.cam_from_frame)
    return AttitudeComparisonOut(
        object_name=result.object_name,
        frame=result.frame,
        cam_from_frame=(x, y, z, w),
        angle_deg=math.degrees(2 * math.atan2(math.hypot(x, y, z), w)),
        rms_arcsec=_arcsec(result.rms_rad),
        frames=len(result.compared),
        outside=result.outside,
        compared=[
            ComparedAttitudeOut(
                frame_id=attitude.frame_id, at=attitude.at, residual_arcsec=_arcsec(attitude.residual_rad)
            )
            for attitude in result.compared
        ],
    )


def _arcsec(vector_rad: Array) -> tuple[float, float, float]:
    x, y, z = (float(v) / ARCSEC_RAD for v in vector_rad)
    return x, y, z
