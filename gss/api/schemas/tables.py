"""Calibrations, parameter sets, triplet tables and bad-pixel tables."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc
from gss.domain.json_object import JsonObject

Scalar = bool | int | float | str


class TablePlaceOut(Out):
    """Table bank of the device that contains a table."""

    bank: str
    state: str
    active: bool


class TableOut(Out):
    """Stored table."""

    id: int
    kind: str
    name: str
    profile: str
    format_version: int
    size: int
    sha256: str
    created: Utc
    author: str
    on_board: list[TablePlaceOut]


class TableDetailOut(TableOut):
    """Stored table with its values."""

    content: JsonObject


class OnBoardTableOut(Out):
    """Table bank as reported by the device. ``table_id``: stored table with the same hash."""

    table: str
    bank: str
    state: str
    active: bool
    size_bytes: int
    capacity_bytes: int
    format_version: int
    profile: str
    confirm_left_s: int
    sha256: str
    table_id: int | None


class TableDefaultsOut(Out):
    """Default values of a new table."""

    kind: str
    profile: str
    content: JsonObject


TableKind = Literal["calibration", "parameters", "triplets", "bad_pixels"]


class TableIn(In):
    """New table: values of the camera, overridden by ``content``. Triplets need content.catalogue_id. The content of a
    bad-pixel table is ``pixels``, a text of column,row pairs with spaces between them. ``profile`` empty: camera of the
    configured instrument."""

    kind: TableKind
    name: str = Field(default="", max_length=80)
    profile: str = Field(default="", max_length=40)
    content: dict[str, Scalar] = Field(default_factory=dict, max_length=200)


class TableUploadIn(In):
    """Inactive table bank to which the table is sent."""

    bank: str = Field(max_length=20)
