"""Detection of satellites and debris in simulated frames: precision, recall against signal-to-noise ratio, position
errors, and identification."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from gss.domain.angles import ARCSEC_RAD, Array, separation_rad
from gss.domain.camera_profile import CameraProfile
from gss.domain.experiment import Cell, Curve, Experiment, Progress, share_text
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.orbit.objects import MeasuredTrack, name_of
from gss.pipeline.chains import reference
from gss.pipeline.chains.reference import KnownSky, known_sky
from gss.pipeline.identify.verify import SkyCatalogue
from gss.pipeline.moving.frame_views import views_of
from gss.pipeline.moving.spots import FrameSpots, find_spots, tangent
from gss.pipeline.moving.tracklets import Linked, Tracklet, link
from validation.moving.population import Population, population
from validation.moving.scenes import SEQUENCE, SINGLE, TOP_RATE_RAD_S, Scene, TrueTrack, scene

CAMERA = "sunsat"
OBJECTS = 400
MAGNITUDES = (2.5, 8.5)
NEAR_PX, NEAR_SHARE = 3.0, 0.1
"""A track matches an object if the median distance between them is less than this number of pixels or this fraction of
the trail."""
MIN_FRAMES = 3
SINGLES_PER_TRIAL = 3
LINE_SNR, LINE_PX = 10.0, 10.0
SNR_EDGES = (0.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0, 25.0, 50.0, 1e4)
TRAIL_EDGES = (0.0, 2.0, 5.0, 10.0, 20.0, 1e4)


@dataclass(frozen=True)
class _ReportedTrack:
    """One reported track. ``row``: the object that it matches, −1 for none. ``name``: name of the identified object, ""
    if none. ``z``: (n, 2) position errors in standard deviations. ``off_px``: (n,) errors in pixels. ``streak``: True
    if the track is a line in a single frame."""

    row: int
    name: str
    z: Array
    off_px: Array
    streak: bool


@dataclass(frozen=True)
class _Result:
    """Results of one scene: the reported tracks, and for each true object its signal-to-noise ratio, its trail length
    and True if it was detected. ``lines``: True for each long line of an object in a single frame that was reported as
    such."""

    reported: list[_ReportedTrack]
    snr: list[float]
    trail_px: list[float]
    detected: list[bool]
    lines: list[bool]


def moving_objects(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Render ``trials`` sequences and search for moving objects in them."""
    profile = shipped_camera(CAMERA)
    catalogue = SkyCatalogue(stars.hip, stars.icrs, stars.v_mag)
    sky = known_sky(catalogue, profile.camera, profile.sensor.faint_limit_mag)
    objects = population(OBJECTS, np.random.default_rng([seed, 0]))
    singles = SINGLES_PER_TRIAL * trials
    scenes = [(SEQUENCE, [seed, 1, k]) for k in range(trials)] + [(SINGLE, [seed, 2, k]) for k in range(singles)]
    results = []
    for k, (timing, seeds) in enumerate(scenes):
        progress(k / len(scenes))
        rendered = scene(profile, stars, objects, MAGNITUDES, np.random.default_rng(seeds), timing)
        results.append(_search_scene(profile, stars, sky, objects, rendered))
    progress(1.0)
    return _experiment(profile, results[:trials], results[trials:], seed)


def _search_scene(
    profile: CameraProfile, stars: StarTable, sky: KnownSky, objects: Population, rendered: Scene
) -> _Result:
    camera, sensor = profile.camera, profile.sensor
    solved = [
        reference.solve_known(image, camera, sensor, sky, exposure_s=sensor.exposure_s) for image in rendered.images
    ]
    views = views_of(rendered.times_s.tolist(), [sensor.exposure_s] * len(solved), solved)
    index = [k for k, r in enumerate(solved) if r.attitude is not None]
    frames: list[FrameSpots] = []
    frame_numbers = []
    for k, view in zip(index, views, strict=True):
        spots = find_spots(rendered.images[k], view, stars, sensor)
        if spots is not None:
            frames.append(spots)
            frame_numbers.append(k)
    linked = link(frames, TOP_RATE_RAD_S) if frames else Linked([], [], [], [])
    detected = [
        _identify_track(t, frame_numbers, rendered, objects, camera.pixel_rad, streak)
        for tracks, streak in ((linked.moving, False), (linked.streaks, True))
        for t in tracks
    ]
    true = [t for t in rendered.tracks if np.count_nonzero(t.on) >= MIN_FRAMES]
    rows = {f.row for f in detected}
    return _Result(
        detected,
        [float(np.median(t.snr[t.on])) for t in true],
        [float(np.median(t.trail_px[t.on])) for t in true],
        [t.row in rows for t in true],
        [t.row in rows for t in rendered.tracks if np.count_nonzero(_long_line(t)) == 1],
    )


def _long_line(track: TrueTrack) -> Array:
    """Return the (n,) mask of the frames in which the object is a long line."""
    return np.asarray(track.on.astype(bool) & (track.snr > LINE_SNR) & (track.trail_px > LINE_PX))


def _identify_track(
    track: Tracklet, frame_numbers: list[int], rendered: Scene, objects: Population, pixel_rad: float, streak: bool
) -> _ReportedTrack:
    index = np.array(frame_numbers)[track.frames]
    best: tuple[float, TrueTrack | None] = (np.inf, None)
    for true in rendered.tracks:
        off = float(np.median(separation_rad(track.icrs, true.icrs[index]))) / pixel_rad
        near_px = max(NEAR_PX, NEAR_SHARE * float(np.median(true.trail_px[index])))
        best = min(best, (off / near_px, true), key=lambda b: b[0])
    named = name_of(
        MeasuredTrack(
            track.times_s,
            track.icrs,
            np.sqrt(np.trace(track.covariance_rad2, axis1=1, axis2=2) / 2),
            rendered.observer_km[index],
        ),
        objects.catalogue,
    )
    name = "" if named is None else named.name
    if best[1] is None or best[0] > 1:
        return _ReportedTrack(-1, name, np.zeros((0, 2)), np.zeros(0), streak)
    true_icrs = best[1].icrs[index]
    error = np.einsum("nij,nj->ni", tangent(track.icrs), true_icrs - track.icrs)
    half = np.linalg.cholesky(track.covariance_rad2)
    z = np.linalg.solve(half, error[..., None])[..., 0]
    return _ReportedTrack(best[1].row, name, z, np.linalg.norm(error, axis=1) / pixel_rad, streak)


def _experiment(profile: CameraProfile, results: list[_Result], singles: list[_Result], seed: int) -> Experiment:
    detected = [f for r in results for f in r.reported]
    linked, streaks = [f for f in detected if not f.streak], [f for r in singles for f in r.reported if f.streak]
    streaks += [f for f in detected if f.streak]
    ends = [abs(z) <= 3 for f in streaks for z in f.z.ravel().tolist()]
    lines = [seen for r in singles for seen in r.lines]
    matched = [f for f in detected if f.row >= 0]
    z = np.concatenate([f.z for f in matched]) if matched else np.zeros((0, 2))
    off = np.concatenate([f.off_px for f in matched]) if matched else np.zeros(0)
    snr = np.array([s for r in results for s in r.snr])
    trail = np.array([t for r in results for t in r.trail_px])
    seen = np.array([s for r in results for s in r.detected], bool)
    named = [f for f in matched if f.name]
    wrong = [f for f in detected if f.name and f.name != f"SIM {f.row}"]
    rows: list[tuple[Cell, ...]] = [
        (
            "precision, tracklets",
            "≥ 95 %",
            _share([f.row >= 0 for f in linked]),
            "reported tracklets that are objects",
        ),
        ("precision, lines in one frame", "≥ 95 %", _share([f.row >= 0 for f in streaks]), "with both ends"),
        ("recall, lines in one frame", None, _share(lines), f"SNR above {LINE_SNR:g}, trail above {LINE_PX:g} px"),
        ("positions of lines within 3 σ, per axis", "99.7 %", _share(ends), "of the stated covariance"),
        (
            "positions within 3 σ, per axis",
            "99.7 %",
            _share((np.abs(z) <= 3).ravel().tolist()),
            "of the stated covariance",
        ),
        ("rms of error over stated error", "1", round(float(np.sqrt(np.mean(z**2))), 3) if len(z) else None, ""),
        ("median error, px", None, round(float(np.median(off)), 3) if len(off) else None, ""),
        ("named", None, share_text(len(named), len(matched)), "true tracklets that the elements explain"),
        ("wrong names", "0", len(wrong), ""),
    ]
    for low, high in itertools.pairwise(SNR_EDGES):
        inside = (snr >= low) & (snr < high)
        if inside.any():
            title = f"recall, SNR {low:g} to {high:g}" if high < 1e4 else f"recall, SNR above {low:g}"
            rows.append((title, None, _share(seen[inside].tolist()), ""))
    for low, high in itertools.pairwise(TRAIL_EDGES):
        inside = (trail >= low) & (trail < high) & (snr >= 10)
        if inside.any():
            title = f"recall, trail {low:g} to {high:g} px" if high < 1e4 else f"recall, trail above {low:g} px"
            rows.append((title, None, _share(seen[inside].tolist()), "SNR above 10"))
    middles, shares = _curve(snr, seen)
    return Experiment(
        "moving-objects",
        "Moving objects: satellites detected in frames",
        "performance of GSS; no publication",
        ("quantity", "goal", "measured", "remark"),
        tuple(rows),
        (
            f"{len(results)} sequences of 10 frames, one per second, of the {profile.title} in a low orbit; "
            f"{len(snr)} objects in at least {MIN_FRAMES} frames, of a population of {OBJECTS}, a fifth of them near the "
            "geostationary ring",
            f"V {MAGNITUDES[0]:g} to {MAGNITUDES[1]:g}, rates to {np.degrees(TOP_RATE_RAD_S):g}°/s, the camera "
            "rotates at 0.01 "
            "or 0.05°/s (1 σ per axis)",
            "each sequence has 8 hot pixels and 2 stars that the catalogue lacks; each frame has on average 3 "
            "pixels hit by particles, 0.3 long particle tracks and 1 flash in the shape of a star",
            f"{len(singles)} further sequences of {SINGLE.frames} frames every {SINGLE.step_s:g} s, in which a fast object "
            "crosses the field between two frames, for the rows of lines in one frame",
            f"a track counts as an object if it is within {NEAR_PX:g} px of the object, or within a tenth of its "
            "trail if that is larger",
            "SNR: signal-to-noise ratio of the light in one frame, with a filter as long as the trail",
            f"one pixel is {profile.camera.pixel_rad / ARCSEC_RAD:.1f}″",
        ),
        seed,
        (
            "The elements of the population are exact, so the names measure confusion of objects and not the age of elements.",
        ),
        (Curve("Recall", "signal-to-noise ratio in one frame", "share found", middles, shares),),
    )


def _share(hits: list[bool]) -> str | None:
    return share_text(sum(hits), len(hits)) if hits else None


def _curve(snr: Array, seen: Array) -> tuple[tuple[float, ...], tuple[float, ...]]:
    middles, shares = [], []
    for low, high in itertools.pairwise(SNR_EDGES):
        inside = (snr >= low) & (snr < min(high, 100.0))
        if inside.any():
            middles.append(float(np.median(snr[inside])))
            shares.append(float(seen[inside].mean()))
    return tuple(middles), tuple(shares)
