"""Orbit of the spacecraft, ground stations and passes."""

from __future__ import annotations

from datetime import datetime
from typing import Literal

from pydantic import Field

from gss.api.schemas.base import Id, In, Out, Utc
from gss.api.schemas.jobs import JobOut
from gss.operations.passes.plan_items import MAX_ITEM_S, MAX_ITEMS, ItemKind, ItemState
from gss.operations.rehearsals.rehearsal_report import RehearsalReport
from gss.orbit.read_orbit import MAX_CHARACTERS


class OrbitIn(In):
    """Orbit to import and activate. ``text``: content of a TLE, OMM (JSON, KVN, XML) or OEM (KVN) file. ``name``: name
    of the spacecraft; "": name in the file. ``source``: origin of the orbit data."""

    text: str = Field(min_length=1, max_length=MAX_CHARACTERS)
    name: str = Field(default="", max_length=80)
    source: str = Field(default="", max_length=200)


class OrbitOut(Out):
    """Imported orbit. ``start`` and ``end``: its validity. ``lines``: the two lines of a TLE, "" for an ephemeris."""

    id: int
    spacecraft: str
    kind: Literal["tle", "oem"]
    source_format: str
    source: str
    epoch: Utc
    user: str
    added: Utc
    lines: str


class SpacecraftOut(Out):
    """Spacecraft with its orbit. ``name`` "" and ``orbit`` null: no orbit was imported. ``state`` and ``advice``: level
    and text that state whether the orbit is recent enough; ``plannable``: true if the orbit is recent enough for pass
    plans. ``history``: all orbits including the active orbit, newest first."""

    name: str
    orbit: OrbitOut | None
    start: Utc | None
    end: Utc | None
    age_days: float | None
    state: Literal["ok", "watch", "warning", "critical", "never"]
    advice: str
    plannable: bool
    history: list[OrbitOut]


class MaskPoint(In):
    """Elevation of the horizon at an azimuth, measured from north towards east."""

    azimuth_deg: float = Field(ge=0, lt=360)
    elevation_deg: float = Field(ge=-10, le=89)


class StationIn(In):
    """Ground station on WGS-84. ``mask``: points with increasing azimuth; empty: a flat horizon. ``line_baud`` 0: the
    rate that the unit reports; ``line_url``: address of the line at this station, "" if unknown."""

    name: str = Field(min_length=1, max_length=60)
    latitude_deg: float = Field(ge=-90, le=90)
    longitude_deg: float = Field(ge=-180, le=180)
    height_m: float = Field(default=0.0, ge=-500, le=9000)
    min_elevation_deg: float = Field(default=5.0, ge=0, le=89)
    mask: list[MaskPoint] = Field(default_factory=list, max_length=360)
    line_url: str = Field(default="", max_length=300)
    line_baud: int = Field(default=0, ge=0, le=100_000_000)
    note: str = Field(default="", max_length=2000)


class MaskPointOut(Out):
    """Elevation of the horizon at an azimuth, measured from north towards east."""

    azimuth_deg: float
    elevation_deg: float


class StationOut(Out):
    """Stored ground station."""

    id: int
    name: str
    latitude_deg: float
    longitude_deg: float
    height_m: float
    min_elevation_deg: float
    mask: list[MaskPointOut]
    line_url: str
    line_baud: int
    note: str
    user: str
    changed: Utc


class TrackPointOut(Out):
    """Direction and distance to the spacecraft. ``sunlit``: true outside the Earth's shadow."""

    at: Utc
    azimuth_deg: float
    elevation_deg: float
    range_km: float
    sunlit: bool


class PassOut(Out):
    """Pass over a ground station, with times in UTC and without refraction. ``sun_elevation_deg``: elevation of the Sun
    at the station at culmination. ``begins_before`` and ``ends_after``: true if the spacecraft is in view at the start
    or end of the searched time range. ``content_bytes``: content that can be downloaded; null if the line rate is
    unknown. ``content_share``: content as a share of the line's bytes, measured from ``downloads`` downloads (0:
    assumed)."""

    station_id: int
    station: str
    rise: Utc
    culmination: Utc
    set: Utc
    duration_s: float
    max_elevation_deg: float
    rise_azimuth_deg: float
    culmination_azimuth_deg: float
    set_azimuth_deg: float
    sun_elevation_deg: float
    sunlit_share: float
    begins_before: bool
    ends_after: bool
    content_bytes: int | None
    content_share: float
    downloads: int
    overlaps: list[str]
    track: list[TrackPointOut]


class PassesOut(Out):
    """Passes in order of rise. ``problem``: why there are no passes, otherwise "". ``warnings``: warnings about the
    orbit and the stations."""

    spacecraft: SpacecraftOut
    start: Utc
    days: float
    problem: str
    warnings: list[str]
    passes: list[PassOut]


class PlanItemIn(In):
    """Item of a plan: a procedure (``procedure_id``), a download (``content`` with ``slot`` or
    ``bank``, like a download request), or the upload of a catalogue (``catalogue_id`` and ``bank``)."""

    kind: ItemKind
    estimated_s: float = Field(gt=0, le=MAX_ITEM_S)
    procedure_id: Id | None = None
    content: Literal[
        "", "frame", "thumbnail", "star_windows", "catalogue", "triplets", "calibration", "parameters", "bad_pixels"
    ] = ""
    slot: int | None = Field(default=None, ge=0, le=255)
    bank: str | None = Field(default=None, min_length=1, max_length=20)
    catalogue_id: Id | None = None


class PlanIn(In):
    """Plan for the pass over a station. ``at``: any time during the pass. ``resume``: true to continue in the next pass
    over the station."""

    name: str = Field(default="", max_length=80)
    station_id: Id
    at: datetime = Field(strict=False)
    resume: bool = False
    items: list[PlanItemIn] = Field(min_length=1, max_length=MAX_ITEMS)


class ArmIn(In):
    """Names that confirm the hazardous commands in the plan's procedures."""

    confirm: list[str] = Field(default_factory=list, max_length=200)


class PlanItemOut(Out):
    """Item with its progress. ``started_id``: id of the run or transfer; times are ISO 8601, "" until known."""

    kind: ItemKind
    title: str
    estimated_s: float
    procedure_id: int | None = None
    content: str
    slot: int | None
    bank: str | None
    catalogue_id: int | None
    state: ItemState
    started_id: int | None
    detail: str
    started: str
    finished: str


class PlanOut(Out):
    """Pass plan. ``problems``: why a draft cannot be armed now. ``confirm``: names to type to arm it."""

    id: int
    name: str
    station_id: int
    station: str
    spacecraft: str
    rise: Utc
    set: Utc
    resume: bool
    items: list[PlanItemOut]
    state: Literal["draft", "armed", "running", "paused", "waiting", "completed", "failed", "stopped", "missed"]
    reason: str
    author: str
    created: Utc
    armed_by: str
    armed: Utc | None
    started: Utc | None
    finished: Utc | None
    planned_s: float
    pass_s: float
    problems: list[str]
    confirm: list[str]


class RehearsalOut(Out):
    """Rehearsal of a plan: its job, and its report after the job has ended."""

    job: JobOut
    report: RehearsalReport | None
