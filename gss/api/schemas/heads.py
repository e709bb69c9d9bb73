"""Several heads on one spacecraft. Rotations and their uncertainties are about the body's axes x, y, z."""

from __future__ import annotations

from typing import Literal

from gss.api.schemas.alarms import AlarmRow
from gss.api.schemas.base import Out, Utc

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class BodyAttitudeOut(Out):
    """Attitude of the body: quaternion body_from_icrs, scalar last; right ascension and declination of body +z, and the
    roll about +z. ``sigma_arcsec``: standard deviation about each axis."""

    quaternion: Quaternion
    ra_deg: float
    dec_deg: float
    roll_deg: float
    sigma_arcsec: Vector


class HeadOut(Out):
    """One head of a spacecraft. ``body_from_cam``: mounting, also as rotations ``mounting_deg`` about x, y and z;
    ``boresight``: unit vector in the body frame; ``sigma_arcsec``: uncertainty of the mounting. ``sigma_cross_arcsec``,
    ``sigma_roll_arcsec``: configured standard deviations for a sensor that reports none. ``served``: true if the server
    has this unit; ``fresh``: true if the unit currently reports attitudes; ``problem``: why its attitude is not used,
    "" if it is used. ``attitude``: attitude of the body measured by this head at the latest comparison."""

    unit: str
    mounting_deg: Vector
    body_from_cam: Quaternion
    boresight: Vector
    sigma_arcsec: float
    sigma_cross_arcsec: float | None
    sigma_roll_arcsec: float | None
    served: bool
    fresh: bool
    age_s: float | None
    problem: str
    attitude: BodyAttitudeOut | None


class MisalignmentOut(Out):
    """Estimated misalignment of a head relative to the reference head: rotation vector that corrects its mounting, and
    the drift of this vector. ``samples``: number of comparisons since the estimation started; ``restarts``: number of
    restarts after sudden changes."""

    misalignment_arcsec: Vector
    misalignment_sigma_arcsec: Vector
    drift_arcsec_h: Vector
    drift_sigma_arcsec_h: Vector
    samples: int
    restarts: int


class HeadPairOut(MisalignmentOut):
    """Comparison of a head with the reference head. ``angle_arcsec``: angle of the rotation between their attitudes;
    ``boresight_arcsec``: measured minus nominal angle between the boresights; ``chi2`` has three degrees of freedom."""

    reference: str
    unit: str
    at: Utc
    angle_arcsec: float
    angle_sigma_arcsec: float
    boresight_arcsec: float
    boresight_sigma_arcsec: float
    chi2: float


class FusedOut(BodyAttitudeOut):
    """Attitude of the body from all usable heads. ``covariance_arcsec2``: xx, xy, xz, yy, yz, zz. ``chi2``, ``freedom``
    and ``probability`` are null with a single head."""

    at: Utc
    units: list[str]
    covariance_arcsec2: tuple[float, float, float, float, float, float]
    chi2: float | None
    freedom: int | None
    probability: float | None


class HeadsOut(Out):
    """Spacecraft with its heads; the first head is the reference. ``state``: agreement of the heads, explained by
    ``text``. ``source``: attitudes that are compared. The request describes the other settings."""

    id: int
    name: str
    source: Literal["on board", "ground"]
    tolerance_s: float
    stale_s: float
    largest_rate_deg_s: float | None
    misalignment_limit_arcsec: float | None
    drift_limit_arcsec_h: float | None
    user: str
    changed: Utc
    state: Literal["ok", "warning", "unknown"]
    text: str
    heads: list[HeadOut]
    fused: FusedOut | None
    pairs: list[HeadPairOut]
    alarms: list[AlarmRow]


class HeadHistoryOut(Out):
    """Stored comparisons of a time range, oldest first."""

    points: list[HeadPairOut]
