"""Sub-catalogues: preview and result. The request is in gss.operations.catalogues.catalogue_request."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc
from gss.domain.json_object import JsonObject
from gss.operations.catalogues.catalogue_report import (
    AmbiguityValues,
    EnvelopeValues,
    FunnelValues,
    MapStar,
    StoredReport,
)


class ListMappingIn(In):
    """Column mapping of a star list, as JSON in a form field. See ``ListMapping`` for the allowed values."""

    columns: dict[str, str] = Field(default_factory=dict)
    units: dict[str, str] = Field(default_factory=dict)
    epoch_jyear: float | None = Field(default=None, allow_inf_nan=False)
    frame: str | None = None
    pm_ra_has_cos_dec: bool = True
    bad_rows: str = "drop"


class PreviewOut(Out):
    """Preview of a build while parameters change. ``bank_source``: origin of ``bank_bytes``: request (asked), sensor,
    or default (usual)."""

    stars: int
    pairs_estimate: int
    bytes_estimate: int
    bank_bytes: int
    bank_source: Literal["asked", "sensor", "usual"]
    funnel: list[FunnelValues]
    sky: list[MapStar]
    envelope: EnvelopeValues
    ambiguity: AmbiguityValues | None
    elapsed_ms: float


class CatalogueOut(Out):
    """Stored catalogue. ``validity_known``: false if it was read back from the device."""

    id: int
    name: str
    profile: str
    format: str
    created: Utc
    author: str
    stars: int
    pairs: int
    bytes: int
    sha256: str
    valid_from: Utc | None
    valid_to: Utc | None
    validity_known: bool
    banks: list[str]


class CatalogueOrbitOut(Out):
    """Comparison of a catalogue with the imported orbit. ``leaves``: time at which the orbit leaves the envelope of the catalogue;
    null: not within a year, or outside already."""

    state: Literal["independent", "unknown", "inside", "leaving", "outside"]
    leaves: Utc | None
    text: str


class CatalogueDetailOut(CatalogueOut, StoredReport):
    """Stored catalogue with its request, manifest, maps and quality report. ``instrument_version``: SHA-256 of the
    instrument package with which the catalogue was built; null: unknown. ``no_magnitude``: number of stars of a catalogue
    read back from the device that are not in ``sky``, because their magnitude is unknown."""

    instrument_version: str | None
    request: JsonObject
    manifest: JsonObject
    reduced_stars: int | None = None
    no_magnitude: int = 0


class UploadIn(In):
    """Inactive bank to which a catalogue is sent. Read-back verification and commit follow automatically."""

    bank: str = Field(pattern="^[A-Z]$")
