"""Spacecraft and their heads: requests from users, and the stored setup."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, ValidationError, model_validator

from gss.catalogue_tools.envelope.attitude import mounting_of, turns_of
from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.errors import BadInput
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix
from gss.operations.requests import Request
from gss.pipeline.heads.fusion import boresight_of, head_covariance
from gss.store.models import Spacecraft

MAX_HEADS = 8
HOUR_S = 3600.0
Source = Literal["on board", "ground"]
Angle = Annotated[float, Field(ge=-360, le=360)]
Component = Annotated[float, Field(ge=-1.01, le=1.01)]
MIN_ARCSEC, MAX_ARCSEC = 1e-3, 648_000.0
"""Valid range of an attitude's standard deviations. A covariance with values outside this range cannot be inverted
reliably."""
Sigma = Annotated[float, Field(ge=MIN_ARCSEC, le=36_000)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
UNIT_LENGTH = 1e-3


def _of_length_1(quaternion: list[float]) -> list[float]:
    if abs(math.hypot(*quaternion) - 1) > UNIT_LENGTH:
        raise ValueError("body_from_cam must be a quaternion of length 1")
    return quaternion


Quaternion = Annotated[list[Component], Field(min_length=4, max_length=4), AfterValidator(_of_length_1)]


class HeadRequest(Request):
    """One head and its mounting. Set either ``mounting_deg`` (rotations about x, then y, then z from the body axes to the
    camera axes) or ``body_from_cam`` (quaternion, scalar last). ``sigma_arcsec``: uncertainty of the mounting about each
    axis. ``sigma_cross_arcsec``, ``sigma_roll_arcsec``: standard deviations of its attitudes, used if the sensor does not
    report them."""

    unit: str = Field(min_length=1, max_length=24)
    mounting_deg: Annotated[list[Angle], Field(min_length=3, max_length=3)] | None = None
    body_from_cam: Quaternion | None = None
    sigma_arcsec: float = Field(default=0.0, ge=0, le=36_000)
    sigma_cross_arcsec: Sigma | None = None
    sigma_roll_arcsec: Sigma | None = None

    @model_validator(mode="after")
    def _one_mounting(self) -> Self:
        if (self.mounting_deg is None) == (self.body_from_cam is None):
            raise ValueError("set either mounting_deg or body_from_cam")
        if (self.sigma_cross_arcsec is None) != (self.sigma_roll_arcsec is None):
            raise ValueError("set both standard deviations of the attitudes, or neither")
        return self


class SpacecraftRequest(Request):
    """A spacecraft with its heads. Misalignments are relative to the first head. ``source``: source of the compared
    attitudes. ``tolerance_s``: largest difference between the time of an attitude and the time of comparison.
    ``stale_s``: a head without attitudes for this time is silent. ``largest_rate_deg_s``: largest rate of the body,
    from which the uncertainty of a head with unknown rate is computed; null: attitudes of such heads are not used. A
    value above its limit raises an alarm; a limit of null raises no alarm."""

    name: str = Field(min_length=1, max_length=40)
    heads: list[HeadRequest] = Field(min_length=1, max_length=MAX_HEADS)
    source: Source = "on board"
    tolerance_s: float = Field(default=1.0, gt=0, le=60)
    stale_s: float = Field(default=30.0, ge=2, le=3600)
    largest_rate_deg_s: float | None = Field(default=None, ge=0, le=20)
    misalignment_limit_arcsec: float | None = Field(default=None, gt=0, le=36_000)
    drift_limit_arcsec_h: float | None = Field(default=None, gt=0, le=36_000)

    @model_validator(mode="after")
    def _different_units(self) -> Self:
        names = [head.unit.lower() for head in self.heads]
        if len(set(names)) < len(names):
            raise ValueError("a unit is listed twice")
        return self


@dataclass(frozen=True)
class HeadMounting:
    """One head. ``body_from_cam`` (4,): nominal mounting. ``sigma_rad``: uncertainty of the mounting about each axis.
    ``usual_rad``: standard deviations across and about the boresight, used if the sensor does not report them; None if not
    stated."""

    unit: str
    body_from_cam: Array
    sigma_rad: float
    usual_rad: tuple[float, float] | None

    @property
    def boresight(self) -> Array:
        """(3,) nominal boresight in the body frame."""
        return boresight_of(self.body_from_cam)

    @property
    def mounting_rad2(self) -> Array:
        """(3, 3) covariance of the mounting."""
        return np.eye(3) * self.sigma_rad**2

    @property
    def turns_deg(self) -> tuple[float, float, float]:
        """The mounting as rotations about x, y and z."""
        return turns_of(matrix_from_quaternion(self.body_from_cam))

    def covariance(self, cross_arcsec: float | None, roll_arcsec: float | None) -> Array | None:
        """Return the (3, 3) covariance of an attitude in the camera frame, from the reported standard deviations if they are
        valid, otherwise from ``usual_rad``. Return None if both are missing."""
        if cross_arcsec is not None and roll_arcsec is not None and _valid(cross_arcsec) and _valid(roll_arcsec):
            return head_covariance(cross_arcsec * ARCSEC_RAD, roll_arcsec * ARCSEC_RAD)
        return None if self.usual_rad is None else head_covariance(*self.usual_rad)


@dataclass(frozen=True)
class SpacecraftSetup:
    """A stored spacecraft. :class:`SpacecraftRequest` describes limits and rate, which are None if not set. ``problem``: why
    the stored values cannot be used, "" if they can; there are then no heads, and the other values are defaults."""

    id: int
    name: str
    heads: tuple[HeadMounting, ...]
    source: Source
    tolerance_s: float
    stale_s: float
    largest_rate_rad_s: float | None
    misalignment_limit_rad: float | None
    drift_limit_rad_s: float | None
    user: str
    changed: datetime
    problem: str

    def head(self, unit: str) -> HeadMounting | None:
        """Return the head with this unit name, None if this spacecraft does not have it."""
        return next((head for head in self.heads if head.unit == unit), None)


def row_values(request: SpacecraftRequest) -> dict[str, object]:
    """Return the database columns of a request. Raises BadInput for a name with unprintable characters."""
    name = " ".join(request.name.split())
    for text in (name, *(head.unit for head in request.heads)):
        if not text or not text.isprintable():
            raise BadInput("A name contains unprintable characters", expected="printable characters", got=repr(text))
    return {
        "name": name,
        "heads": [_head_values(head) for head in request.heads],
        "source": request.source,
        "tolerance_s": request.tolerance_s,
        "stale_s": request.stale_s,
        "largest_rate_rad_s": _scaled(request.largest_rate_deg_s, math.radians(1)),
        "misalignment_limit_rad": _scaled(request.misalignment_limit_arcsec, ARCSEC_RAD),
        "drift_limit_rad_s": _scaled(request.drift_limit_arcsec_h, ARCSEC_RAD / HOUR_S),
    }


def setup_of(row: Spacecraft) -> SpacecraftSetup:
    """Return a stored spacecraft."""
    problem = ""
    try:
        stored = _StoredSpacecraft.model_validate({name: getattr(row, name) for name in _StoredSpacecraft.model_fields})
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"])
        problem = f"The stored spacecraft is damaged: {field}: {first['msg']}. Edit or delete it."
        stored = _StoredSpacecraft.model_construct(heads=[])
    return SpacecraftSetup(
        id=row.id,
        name=row.name,
        heads=tuple(HeadMounting(h.unit, np.array(h.body_from_cam), h.sigma_rad, h.usual_rad) for h in stored.heads),
        source=stored.source,
        tolerance_s=stored.tolerance_s,
        stale_s=stored.stale_s,
        largest_rate_rad_s=stored.largest_rate_rad_s,
        misalignment_limit_rad=stored.misalignment_limit_rad,
        drift_limit_rad_s=stored.drift_limit_rad_s,
        user=row.user,
        changed=row.changed,
        problem=problem,
    )


def head_columns(head: HeadMounting) -> dict[str, object]:
    """Return the stored JSON values of a head."""
    return {
        "unit": head.unit,
        "body_from_cam": [float(q) for q in head.body_from_cam],
        "sigma_rad": head.sigma_rad,
        "usual_rad": None if head.usual_rad is None else list(head.usual_rad),
    }


def _head_values(head: HeadRequest) -> dict[str, object]:
    if head.body_from_cam is not None:
        quaternion = np.array(head.body_from_cam) / np.linalg.norm(head.body_from_cam)
    else:
        rows = mounting_of(None, head.mounting_deg)
        if rows is None:
            raise BadInput("a head has no mounting", expected="mounting_deg or body_from_cam", got=head.unit)
        quaternion = quaternion_from_matrix(np.array(rows).reshape(3, 3))
    cross, roll = head.sigma_cross_arcsec, head.sigma_roll_arcsec
    usual = None if cross is None or roll is None else (cross * ARCSEC_RAD, roll * ARCSEC_RAD)
    return head_columns(HeadMounting(head.unit, quaternion, head.sigma_arcsec * ARCSEC_RAD, usual))


class _StoredHead(Request):
    """A head as stored in the column ``heads``."""

    unit: str
    body_from_cam: Quaternion
    sigma_rad: NotNegative
    usual_rad: tuple[Positive, Positive] | None = Field(default=None, strict=False)


class _StoredSpacecraft(Request):
    """Columns of a stored spacecraft. The defaults are those of a new one."""

    heads: list[_StoredHead] = Field(min_length=1)
    source: Source = "on board"
    tolerance_s: Positive = 1.0
    stale_s: Positive = 30.0
    largest_rate_rad_s: NotNegative | None = None
    misalignment_limit_rad: Positive | None = None
    drift_limit_rad_s: Positive | None = None


def _valid(sigma_arcsec: float) -> bool:
    return MIN_ARCSEC <= sigma_arcsec <= MAX_ARCSEC


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor
