"""Catalogue differences, the bank timeline, and imported star lists."""

from __future__ import annotations

from typing import Literal

from gss.api.schemas.base import Out, Utc
from gss.domain.json_object import JsonObject


class ChangedStarOut(Out):
    """Star that differs between two catalogues. ``moved_arcsec``, ``change_mag``: null if that value did not change.
    Positions are from the new catalogue; the position of a dropped star is from the old catalogue."""

    hip: int
    name: str
    ra_deg: float
    dec_deg: float
    v_mag: float | None
    moved_arcsec: float | None = None
    change_mag: float | None = None


class CoverageOut(Out):
    """Number of stars in a field-sized circle around each HEALPix ring pixel. ``poorer``: number of circles with at
    least three stars in the old catalogue and fewer in the new."""

    nside: int
    radius_deg: float
    old: list[int]
    new: list[int]
    poorer: int


class CatalogueRefOut(Out):
    """Reference to a catalogue. ``epoch_jyear``: epoch of its star positions."""

    id: int
    name: str
    profile: str
    format: str
    sha256: str
    stars: int
    pairs: int
    bytes: int
    epoch_jyear: float | None


class CatalogueDiffOut(Out):
    """Changes on board if the new catalogue replaced the old. The counts are complete; each list contains at most 500
    stars, brightest first."""

    old: CatalogueRefOut
    new: CatalogueRefOut
    same_camera: bool
    nothing: bool
    added_count: int
    dropped_count: int
    moved_count: int
    magnitude_count: int
    same_count: int
    unknown_old: int
    unknown_new: int
    added: list[ChangedStarOut]
    dropped: list[ChangedStarOut]
    moved: list[ChangedStarOut]
    magnitude: list[ChangedStarOut]
    coverage: CoverageOut


class BankStayOut(Out):
    """Period in which a bank had one state and content. ``ended``: null if the bank has not changed until the last
    report; ``reported``: time of the last report."""

    bank: str
    state: str
    sha256: str
    name: str
    catalogue_id: int | None
    stars: int | None
    valid_from: Utc | None
    valid_to: Utc | None
    days_left: float | None
    began: Utc
    ended: Utc | None
    reported: Utc
    how: str
    user: str


class BankPlanOut(Out):
    """Planned upload to a bank, or planned activation. ``at``: null if the change happens when the transfer is
    complete."""

    bank: str
    kind: Literal["upload", "activation"]
    at: Utc | None
    name: str
    catalogue_id: int | None
    valid_from: Utc | None
    valid_to: Utc | None
    text: str


class DeviceRefOut(Out):
    """Device with recorded banks. ``simulated``: null if this is not known."""

    id: int
    name: str
    simulated: bool | None


class ContactSpanOut(Out):
    """Contact on the timeline. ``ended`` null: still open."""

    id: int
    started: Utc
    ended: Utc | None


class CoverOut(Out):
    """Period for which valid catalogues are on board or planned, with its state."""

    state: str
    text: str
    until: Utc | None


class TimelineOut(Out):
    """Past, current and planned catalogues in each bank of a device."""

    device: DeviceRefOut
    devices: list[DeviceRefOut]
    now: Utc
    start: Utc
    end: Utc
    stays: list[BankStayOut]
    planned: list[BankPlanOut]
    contacts: list[ContactSpanOut]
    cover: CoverOut


class StarListOut(Out):
    """Imported star list, with a report of the rows read and dropped."""

    id: int
    name: str
    created: Utc
    author: str
    format: str
    epoch_jyear: float
    frame: str
    profile: str
    stars: int
    dropped: int
    size: int
    sha256: str
    report: JsonObject
