"""Detects, links and identifies moving objects in a sequence of frames, and returns them as a record for programs and
as TDM."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from gss.domain.angles import Array, ra_dec_from_unit
from gss.domain.errors import BadInput
from gss.operations.frames.solve import Solver
from gss.operations.studies.analyse import AnalysisResult, AnalysisRun, subject_of
from gss.operations.studies.moving_sheet import MovingRecord, RejectedSource, TrackRecord, moving_report
from gss.operations.studies.night_frames import ProgressCallback, Shot, apparent_stars
from gss.orbit.objects import (
    MeasuredTrack,
    TrackName,
    catalogue_of,
    name_of,
    places_of_orbit,
    places_of_station,
    read_objects,
)
from gss.orbit.read_orbit import read_orbit
from gss.orbit.station import GroundStation, checked_station
from gss.orbit.tdm import TdmTrack, tdm_of
from gss.orbit.trajectory import Trajectory
from gss.pipeline.calibration.plain_values import as_record
from gss.pipeline.moving.frame_views import views_of
from gss.pipeline.moving.spots import FrameSpots, find_spots
from gss.pipeline.moving.tracklets import Tracklet, link

MAX_REJECTED = 2000
"""Maximum number of rejected sources that the record lists. The counts in the record include all rejected sources."""
UNKNOWN_PLACE = "position of the camera not known"


@dataclass(frozen=True)
class CameraPlace:
    """Position of the camera. ``name``: name for the report and the TDM; ``at``: function that returns (n, 3) km from
    the Earth's centre in ICRS axes at (n,) Unix seconds."""

    name: str
    at: Callable[[Array], Array]


def place_of_orbit(name: str, orbit: Trajectory) -> CameraPlace:
    """Return the position of a camera on a spacecraft."""
    return CameraPlace(name or "SPACECRAFT", lambda times_s: places_of_orbit(orbit, times_s))


def place_of(orbit: str, site: tuple[float, float, float] | None) -> CameraPlace | None:
    """Return the position of a camera from the text of an orbit file, or from a site with latitude and longitude in
    degrees and height in metres; None if neither is given. Raises BadInput."""
    if orbit and site is not None:
        raise BadInput(
            "two positions of the camera are given", expected="an orbit or a site", got="an orbit and a site"
        )
    if orbit:
        read = read_orbit(orbit)
        return place_of_orbit(read.name, read.orbit)
    if site is None:
        return None
    station = checked_station(GroundStation("SITE", math.radians(site[0]), math.radians(site[1]), site[2]))
    return CameraPlace("SITE", lambda times_s: places_of_station(station, times_s))


def moving_objects(
    solver: Solver,
    run: AnalysisRun,
    *,
    objects: str,
    place: CameraPlace | None,
    top_rate_rad_s: float,
    created: datetime,
    progress: ProgressCallback,
) -> AnalysisResult:
    """Return the objects that move across the solved frames of a run. ``objects``: two-line elements of objects to
    identify. Raises BadInput."""
    catalogue = catalogue_of(read_objects(objects))
    frames, shots = _sources(solver, run, progress)
    if not frames:
        raise BadInput(
            "no frame contains enough stars",
            expected="three stars that are not saturated",
            got="fewer",
            hint="Check exposure and focus.",
        )
    linked = link(frames, top_rate_rad_s, lambda share: progress(0.8 + 0.15 * share, "Linking the sources"))
    progress(0.95, "Naming the tracks")
    tracks: list[TrackRecord] = []
    measured: list[TdmTrack] = []
    explained: set[tuple[int, int]] = set()
    for k, tracklet in enumerate([*linked.resting, *linked.moving, *linked.streaks]):
        name = name_of(_measured(tracklet, place), catalogue)
        if k < len(linked.resting):
            if name is None:
                continue
            explained |= {(int(f), int(r)) for f, r in zip(tracklet.frames, tracklet.rows, strict=True)}
        label = f"{'S' if len(tracklet) == 1 else 'T'}{len(tracks) + 1}"
        tracks.append(_record(label, tracklet, name))
        measured.append(
            TdmTrack(
                label if name is None else name.name,
                tracklet.times_s,
                tracklet.icrs,
                tracklet.v_mag,
                float(_sigma(tracklet).mean()),
            )
        )
    exposure_s = float(np.median([f.view.exposure_s for f in frames]))
    reasons, rejected = _rejected(frames, shots, linked.reasons, explained)
    record = MovingRecord(
        len(run.shots),
        len(frames),
        UNKNOWN_PLACE if place is None else place.name,
        len(catalogue.objects),
        float(np.median([f.limit_mag for f in frames])),
        tracks,
        reasons,
        rejected,
        "".join(tdm_of(measured, "CAMERA" if place is None else place.name, exposure_s, created)),
    )
    return AnalysisResult("moving", moving_report(record, run.profile.camera, subject_of(run)), dict(as_record(record)))


def _sources(solver: Solver, run: AnalysisRun, progress: ProgressCallback) -> tuple[list[FrameSpots], list[Shot]]:
    """Return the light sources of all solved frames, and the shots of these frames."""
    solved = [
        (shot, result)
        for shot, result in zip(run.shots, run.results, strict=True)
        if result is not None and result.attitude is not None
    ]
    sensor = run.profile.sensor
    exposures = [sensor.exposure_s if s.exposure_s is None else s.exposure_s for s, _ in solved]
    views = views_of([s.taken.timestamp() for s, _ in solved], exposures, [r for _, r in solved])
    frames, shots = [], []
    for k, ((shot, _), view) in enumerate(zip(solved, views, strict=True)):
        progress(0.5 + 0.3 * k / len(solved), f"Sources of {shot.name}, {k + 1} of {len(solved)}")
        pixels, _ = solver.cleaned(shot.pixels(), run.profile, shot.exposure_s)
        spots = find_spots(pixels, view, apparent_stars(solver, shot), sensor)
        if spots is not None:
            frames.append(spots)
            shots.append(shot)
    return frames, shots


def _sigma(tracklet: Tracklet) -> Array:
    """Return the (n,) standard deviations per axis in radians."""
    return np.asarray(np.sqrt(np.trace(tracklet.covariance_rad2, axis1=1, axis2=2) / 2))


def _measured(tracklet: Tracklet, place: CameraPlace | None) -> MeasuredTrack:
    camera_km = None if place is None else place.at(tracklet.times_s)
    return MeasuredTrack(tracklet.times_s, tracklet.icrs, _sigma(tracklet), camera_km)


def _record(label: str, tracklet: Tracklet, name: TrackName | None) -> TrackRecord:
    ra, dec = ra_dec_from_unit(tracklet.icrs)
    has_ends = np.asarray(np.isfinite(tracklet.ends_icrs).all(axis=(1, 2)))
    ends_ra, ends_dec = ra_dec_from_unit(tracklet.ends_icrs)
    return TrackRecord(
        label,
        len(tracklet) == 1,
        name,
        tracklet.times_s,
        ra,
        dec,
        tracklet.covariance_rad2,
        tracklet.v_mag,
        tracklet.snr,
        tracklet.rate_rad_s,
        tracklet.rate_covariance,
        tracklet.chance,
        np.where(has_ends[:, None], ends_ra, np.nan),
        np.where(has_ends[:, None], ends_dec, np.nan),
        tracklet.ends_sigma_rad,
    )


def _rejected(
    frames: list[FrameSpots], shots: list[Shot], reasons: list[list[str]], explained: set[tuple[int, int]]
) -> tuple[dict[str, int], list[RejectedSource]]:
    """Count the reasons and list the rejected sources. ``explained``: frame and row of each source that is a planet."""
    counts: dict[str, int] = {}
    rejected: list[RejectedSource] = []
    for k, (frame, shot) in enumerate(zip(frames, shots, strict=True)):
        for row, reason in enumerate(reasons[k]):
            if not reason or (k, row) in explained:
                continue
            counts[reason] = counts.get(reason, 0) + 1
            if len(rejected) < MAX_REJECTED:
                col_px, row_px = (float(v) for v in frame.pixels[row])
                rejected.append(RejectedSource(shot.name, col_px, row_px, float(frame.v_mag[row]), reason))
    return counts, rejected
