"""Writer of CCSDS attitude messages in KVN: AEM (CCSDS 504.0-B-1), and ACM with covariances (504.0-B-2). The older version of the
AEM is used because it states the direction of the rotation and more programs can read it.

The quaternion of the standard rotates the axes of frame A to the axes of frame B. Its matrix (ibid. annex) is the transpose of the
matrix that the same components represent in GSS's convention, so the sign of the vector part is changed.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Literal

import numpy as np

from gss.domain.rotation import quaternion_inverse
from gss.orbit.attitude import AttitudeHistory

Basis = Literal["DETERMINED_GND", "DETERMINED_OBC"]
MessageFormat = Literal["aem", "acm"]


def attitude_message(kind: MessageFormat, history: AttitudeHistory, basis: Basis, created: datetime) -> Iterator[str]:
    """Yield the lines of a message. ``basis``: where the attitudes were determined; an AEM does not state it."""
    return aem_of(history, created) if kind == "aem" else acm_of(history, basis, created)


def aem_of(history: AttitudeHistory, created: datetime) -> Iterator[str]:
    """Yield the lines of an attitude ephemeris message with rotations from ICRF to the frame of the attitudes, in UTC."""
    times = [_time(t) for t in history.times_s]
    yield f"CCSDS_AEM_VERS = 1.0\nCREATION_DATE = {_time(created.timestamp())}\nORIGINATOR = GSS\n\nMETA_START\n"
    yield f"OBJECT_NAME = {history.object_name}\nOBJECT_ID = {history.object_name}\n"
    yield f"REF_FRAME_A = ICRF\nREF_FRAME_B = {history.frame}\nATTITUDE_DIR = A2B\nTIME_SYSTEM = UTC\n"
    yield f"START_TIME = {times[0]}\nSTOP_TIME = {times[-1]}\n"
    yield "ATTITUDE_TYPE = QUATERNION\nQUATERNION_TYPE = LAST\nMETA_STOP\n\nDATA_START\n"
    for at, quaternion in zip(times, quaternion_inverse(history.quaternions), strict=True):
        yield f"{at} {' '.join(f'{q:.12f}' for q in quaternion)}\n"
    yield "DATA_STOP\n"


def acm_of(history: AttitudeHistory, basis: Basis, created: datetime) -> Iterator[str]:
    """Yield the lines of an attitude comprehensive message. It contains the attitudes of :func:`aem_of`, and the variances of the
    angles about the axes of the frame in deg² if they are known. ``basis``: where the attitudes were determined. Times are in
    seconds from the first attitude."""
    zero_s = float(history.times_s[0])
    yield f"CCSDS_ACM_VERS = 2.0\nCREATION_DATE = {_time(created.timestamp())}\nORIGINATOR = GSS\n\nMETA_START\n"
    yield f"OBJECT_NAME = {history.object_name}\nTIME_SYSTEM = UTC\nEPOCH_TZERO = {_time(zero_s)}\nMETA_STOP\n\n"
    yield f"ATT_START\nATT_BASIS = {basis}\nREF_FRAME_A = ICRF\nREF_FRAME_B = {history.frame}\n"
    yield "NUMBER_STATES = 4\nATT_TYPE = QUATERNION\n"
    for t, quaternion in zip(history.times_s, quaternion_inverse(history.quaternions), strict=True):
        yield f"{t - zero_s:.6f} {' '.join(f'{q:.12f}' for q in quaternion)}\n"
    yield "ATT_STOP\n"
    stated = np.isfinite(history.sigma_rad).all(axis=1)
    if stated.any():
        yield f"\nCOV_START\nCOV_BASIS = {basis}\nCOV_REF_FRAME = {history.frame}\nCOV_TYPE = ANGLE\n"
        for t, variances in zip(history.times_s[stated], np.degrees(history.sigma_rad[stated]) ** 2, strict=True):
            yield f"{t - zero_s:.6f} {' '.join(f'{v:.6e}' for v in variances)}\n"
        yield "COV_STOP\n"


def _time(unix_s: float) -> str:
    return datetime.fromtimestamp(round(unix_s, 6), UTC).isoformat(timespec="microseconds").replace("+00:00", "")
