"""Sub-catalogues over time and beside each other: differences, banks by date, star lists that were brought."""

from __future__ import annotations

from typing import Any, Literal

from gss.api.schemas.base import Out, Utc


class ChangedStarOut(Out):
    """A star that is not as it was. ``moved_arcsec``, ``change_mag``: None where that is not the difference. Places are those of
    the new catalogue, of the old one for a dropped star."""

    hip: int
    name: str
    ra_deg: float
    dec_deg: float
    v_mag: float | None
    moved_arcsec: float | None = None
    change_mag: float | None = None


class CoverageOut(Out):
    """Stars in a circle as large as a field round each HEALPix ring pixel. ``poorer``: circles that had three and have not."""

    nside: int
    radius_deg: float
    old: list[int]
    new: list[int]
    poorer: int


class CatalogueRefOut(Out):
    """Which catalogue. ``epoch_jyear``: when its stars are where it has them."""

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
    """What would change on board. Numbers are whole; the lists hold at most the first 500 stars, brightest first."""

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
    """One bank in one state with one content. ``ended`` None: still so, as far as was told."""

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
    told: Utc
    how: str
    user: str


class BankPlanOut(Out):
    """Something that will be in a bank, or become active there. ``at`` None: as soon as it has arrived."""

    bank: str
    kind: Literal["upload", "activation"]
    at: Utc | None
    name: str
    catalogue_id: int | None
    valid_from: Utc | None
    valid_to: Utc | None
    text: str


class DeviceRefOut(Out):
    """A device whose banks are on record."""

    id: int
    name: str
    simulated: bool


class ContactSpanOut(Out):
    """A contact, for a tick. ``ended`` None: it is still open."""

    id: int
    started: Utc
    ended: Utc | None


class CoverOut(Out):
    """Is there a catalogue for the sky to come, in words."""

    state: str
    text: str
    until: Utc | None


class TimelineOut(Out):
    """Which catalogue is, was and will be in which bank of a device."""

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
    """A star list that somebody brought, with what was read and what was dropped."""

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
    report: dict[str, Any]
