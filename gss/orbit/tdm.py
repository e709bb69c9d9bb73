"""Writer of CCSDS Tracking Data Messages in KVN (CCSDS 503.0-B-2) with angles and magnitudes of measured objects."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from gss.domain.angles import ARCSEC_RAD, Array, ra_dec_from_unit


@dataclass(frozen=True)
class TdmTrack:
    """Measured directions of one object. ``participant``: name of the object. ``times_s``: (n,) Unix seconds. ``icrs``: (n, 3)
    directions in ICRS axes. ``v_mag``: (n,) magnitudes. ``sigma_rad``: mean standard deviation of a direction per axis."""

    participant: str
    times_s: Array
    icrs: Array
    v_mag: Array
    sigma_rad: float


def tdm_of(tracks: Sequence[TdmTrack], observer: str, exposure_s: float, created: datetime) -> Iterator[str]:
    """Yield the lines of a TDM with one segment per object. ``observer``: name of participant 1. ``exposure_s``: integration
    interval."""
    yield f"CCSDS_TDM_VERS = 2.0\nCREATION_DATE = {created:%Y-%m-%dT%H:%M:%S}\nORIGINATOR = GSS\n"
    for number, track in enumerate(tracks, 1):
        yield "\nMETA_START\n"
        yield f"COMMENT standard deviation of a direction {track.sigma_rad / ARCSEC_RAD:.2f} arcsec per axis\n"
        yield "COMMENT directions relative to catalogue stars: aberration by the Earth's motion is removed\n"
        yield f"TRACK_ID = {number}\nDATA_TYPES = ANGLE_1,ANGLE_2,MAG\nTIME_SYSTEM = UTC\n"
        yield f"START_TIME = {_time(track.times_s.min())}\nSTOP_TIME = {_time(track.times_s.max())}\n"
        yield f"PARTICIPANT_1 = {_plain(observer)}\nPARTICIPANT_2 = {_plain(track.participant)}\n"
        yield "MODE = SEQUENTIAL\nPATH = 2,1\nTIMETAG_REF = RECEIVE\n"
        yield f"INTEGRATION_INTERVAL = {exposure_s:g}\nINTEGRATION_REF = MIDDLE\n"
        yield "ANGLE_TYPE = RADEC\nREFERENCE_FRAME = ICRF\nDATA_QUALITY = RAW\nMETA_STOP\n\nDATA_START\n"
        ra, dec = (np.degrees(v) for v in ra_dec_from_unit(track.icrs))
        for at_s, a, d, m in zip(track.times_s, ra, dec, track.v_mag, strict=True):
            yield f"ANGLE_1 = {_time(at_s)} {a:.7f}\nANGLE_2 = {_time(at_s)} {d:.7f}\nMAG = {_time(at_s)} {m:.2f}\n"
        yield "DATA_STOP\n"


def _time(seconds: float) -> str:
    return datetime.fromtimestamp(float(seconds), UTC).isoformat(timespec="microseconds").removesuffix("+00:00")


def _plain(name: str) -> str:
    """Return a name as one line of printable ASCII, which the format requires."""
    return "".join(c if " " <= c <= "~" else "_" for c in name).strip() or "UNKNOWN"
