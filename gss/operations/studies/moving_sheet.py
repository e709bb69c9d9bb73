"""Report of moving objects: tracks on the sky, magnitudes, rates, names, and rejected sources."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.camera import Camera
from gss.domain.words import counted
from gss.operations.report.figures import number
from gss.operations.report.parts import Fact, Note, Plot, Report, Section, Series, Table
from gss.operations.studies.sheet_pieces import finite, maybe, numbers
from gss.orbit.objects import TrackName

MAX_DRAWN = 12
MAX_LISTED = 100


@dataclass(frozen=True)
class TrackRecord:
    """One object. ``streak``: True for a trail in a single frame, whose direction of motion is not known. ``name``: the
    identified object. ``times_s`` (n,): Unix seconds of mid exposure; ``ra_rad``, ``dec_rad`` (n,): in the system of
    the star catalogue, with ``covariance_rad2`` (n, 2, 2) east and north; ``rate_rad_s`` (2,): east and north at the
    middle of the track, with ``rate_covariance``; ``chance``: expected number of such tracks formed by unrelated
    sources; ``ends_ra_rad``, ``ends_dec_rad``, ``ends_sigma_rad`` (n, 2): both ends of the trail in the order of the
    motion, NaN for a point source."""

    label: str
    streak: bool
    name: TrackName | None
    times_s: Array
    ra_rad: Array
    dec_rad: Array
    covariance_rad2: Array
    v_mag: Array
    snr: Array
    rate_rad_s: Array
    rate_covariance: Array
    chance: float
    ends_ra_rad: Array
    ends_dec_rad: Array
    ends_sigma_rad: Array

    @property
    def title(self) -> str:
        """Name of the object, or its label if it is not identified."""
        return self.label if self.name is None else self.name.name


@dataclass(frozen=True)
class RejectedSource:
    """A light source that is not a moving object: frame, position on the detector, magnitude and the reason."""

    frame: str
    col_px: float
    row_px: float
    v_mag: float
    reason: str


@dataclass(frozen=True)
class MovingRecord:
    """Result of a sequence. ``used``: number of frames with an attitude; ``place``: position of the camera;
    ``known_objects``: number of element sets compared; ``limit_mag``: magnitude of the faintest detectable point;
    ``reasons``: number of rejected sources by reason; ``tdm``: tracks as CCSDS TDM."""

    frames: int
    used: int
    place: str
    known_objects: int
    limit_mag: float
    tracks: list[TrackRecord]
    reasons: dict[str, int]
    rejected: list[RejectedSource]
    tdm: str


def moving_report(record: MovingRecord, camera: Camera, subject: str) -> Report:
    """Return the report of moving objects."""
    identified = sum(t.name is not None for t in record.tracks)
    streaks = sum(t.streak for t in record.tracks)
    facts = [
        Fact("objects", number(len(record.tracks)), "", f"{identified} named, {streaks} in one frame only"),
        Fact("frames with an attitude", f"{record.used} of {record.frames}"),
        Fact(
            "faintest point found",
            number(record.limit_mag, 3),
            "V",
            "five standard deviations, at rest on the detector",
        ),
        Fact("camera", record.place),
        Fact("compared with", f"the planets, {counted(record.known_objects, 'element set')}"),
        Fact("rejected sources", number(sum(record.reasons.values()))),
    ]
    text = (
        "Light sources without a star, linked over the frames. Directions are in the system of the star catalogue; "
        "T: several frames, S: a line in one frame."
    )
    drawings = [_sky(record.tracks), _brightness(record.tracks)] if record.tracks else []
    sections = [Section("Objects", text, facts, list(drawings), [_table(record.tracks)] if record.tracks else [])]
    lines = _ends(record.tracks)
    if lines.rows:
        caption = "Directions at the start and the end of the exposure; for S, the order is unknown."
        sections.append(Section("Trails", caption, [], [], [lines]))
    if record.reasons:
        counts = [[reason, number(n)] for reason, n in sorted(record.reasons.items(), key=lambda r: -r[1])]
        rejected_rows = [
            [r.frame, f"{r.col_px:.1f}", f"{r.row_px:.1f}", f"{r.v_mag:.1f}", r.reason]
            for r in record.rejected[:MAX_LISTED]
        ]
        sections.append(
            Section(
                "Rejected sources",
                ""
                if len(record.rejected) <= MAX_LISTED
                else f"The table shows the first {MAX_LISTED}; the JSON file contains more.",
                [],
                [],
                [
                    Table("Reasons", ["reason", "sources"], counts),
                    Table("Sources", ["frame", "column", "row", "V", "reason"], rejected_rows),
                ],
            )
        )
    return Report("Moving objects", subject, sections, _notes(record, camera))


def _notes(record: MovingRecord, camera: Camera) -> list[Note]:
    notes = []
    if record.used < 3:
        notes.append(
            Note(
                "with fewer than three frames, only lines in one frame can be detected",
                "Take a sequence in which an object stays in the field for several frames.",
                code="frames",
            )
        )
    if record.known_objects and any(t.name is None for t in record.tracks) and "not known" in record.place:
        notes.append(
            Note(
                "satellites cannot be identified, because the position of the camera is not known",
                "State the orbit of the spacecraft or the site of the camera.",
                code="place",
            )
        )
    return notes


def _sky(tracks: list[TrackRecord]) -> Plot:
    """Plot declination against right ascension. The right ascension is continuous in the neighbourhood of the first
    object."""
    first_ra_rad = float(tracks[0].ra_rad[0])
    series = []
    for track in tracks[:MAX_DRAWN]:
        ra = first_ra_rad + (track.ra_rad - first_ra_rad + np.pi) % (2 * np.pi) - np.pi
        series.append(Series(track.title, numbers(np.degrees(ra)), maybe(np.degrees(track.dec_rad)), "dots"))
    return Plot("Tracks on the sky", "right ascension, °", "declination, °", series)


def _brightness(tracks: list[TrackRecord]) -> Plot:
    series = [Series(t.title, numbers(t.times_s), maybe(t.v_mag), "dots") for t in tracks[:MAX_DRAWN]]
    return Plot("Magnitudes", "UTC", "V", series, time=True)


def _table(tracks: list[TrackRecord]) -> Table:
    rows = []
    for track in tracks:
        middle = len(track.times_s) // 2
        sigma = np.sqrt(np.trace(track.covariance_rad2, axis1=1, axis2=2) / 2).mean() / ARCSEC_RAD
        rate = np.hypot(*track.rate_rad_s) / ARCSEC_RAD
        towards = np.degrees(np.arctan2(track.rate_rad_s[0], track.rate_rad_s[1])) % 360
        middle_time = datetime.fromtimestamp(float(track.times_s[middle]), UTC)
        explained = "–"
        if track.name is not None:
            km = finite(track.name.range_km)
            explained = f"{track.name.off_rad / ARCSEC_RAD:.0f}″ off" + ("" if km is None else f", {km:.0f} km")
            explained += f"; or {', '.join(track.name.others)}" if track.name.others else ""
        rows.append(
            [
                track.label,
                "unknown" if track.name is None else f"{track.name.name} {track.name.number}".strip(),
                str(len(track.times_s)),
                f"{middle_time:%Y-%m-%d %H:%M:%S.%f}"[:-3],
                f"{np.degrees(track.ra_rad[middle]):.4f}",
                f"{np.degrees(track.dec_rad[middle]):.4f}",
                number(float(sigma), 2),
                number(finite(float(rate)), 3),
                number(finite(float(towards)), 3),
                f"{np.median(track.v_mag):.1f}",
                number(float(np.median(track.snr)), 2),
                explained,
            ]
        )
    column_titles = [
        "",
        "object",
        "frames",
        "UTC of the middle",
        "RA °",
        "Dec °",
        "σ ″",
        "rate ″/s",
        "towards °",
        "V",
        "SNR",
    ]
    return Table("Objects", [*column_titles, "prediction"], rows)


def _ends(tracks: list[TrackRecord]) -> Table:
    rows = []
    for track in tracks:
        for k in np.flatnonzero(np.isfinite(track.ends_ra_rad).all(axis=1))[:MAX_LISTED]:
            time = datetime.fromtimestamp(float(track.times_s[k]), UTC)
            ra, dec = np.degrees(track.ends_ra_rad[k]), np.degrees(track.ends_dec_rad[k])
            rows.append(
                [
                    track.label,
                    f"{time:%H:%M:%S.%f}"[:-3],
                    *(f"{a:.4f}, {d:.4f}" for a, d in zip(ra, dec, strict=True)),
                    number(float(track.ends_sigma_rad[k].mean() / ARCSEC_RAD), 2),
                ]
            )
    return Table("Ends of trails", ["", "UTC", "first end, RA Dec °", "last end, RA Dec °", "σ ″"], rows[:MAX_LISTED])
