"""Linking of the sources of successive frames into tracklets. A tracklet is one object that moves smoothly over the
sky.

Every pair of sources in nearby frames is extrapolated along its great circle. A third source within the gate starts a
tracklet, which is extended to later and earlier frames by a polynomial of degree 1 to 3 in the tangent plane. A
tracklet is accepted if the expected number of accidental tracklets of this quality is small, and the trail of each
source must agree with the motion. The method is the simplest form of the linking of Kubica et al. 2007 (Icarus 189,
151), without trees.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.domain.angles import Array, separation_rad
from gss.pipeline.moving.motion import Hit, SkyMotion, fit_motion, gate_rad, trail_agrees
from gss.pipeline.moving.spots import FrameSpots, star_trail_px

SEED_FRAMES = 3
"""Maximum number of frames between the sources of a pair, and between the pair and its third source."""
MAX_STEP_S = 120.0
"""Maximum time between linked sources. Over a longer time, the motion between them is too uncertain."""
MAX_MISSES = 3
MIN_HITS = 3
MAX_CHANCE = 0.01
"""Maximum expected number of accidental tracklets of the same quality in the sequence. A tracklet with a larger number
is rejected."""
SAME_PIXEL_PX = 0.8
SKY_MOVED_PX = 2.0
STREAK_SNR = 8.0
STREAK_LENGTH = 4.0
"""Minimum length, in widths of the stars, of a line that is reported from a single frame."""
REST_SIGMA = 4.0

HOT = "fixed on the detector: hot pixel or defect"
SHARP = "narrower than the stars: cosmic ray or single pixel"
ONCE = "in one frame only"
REST = "at rest on the sky: star that is not in the catalogue, or too slow for this sequence"
CHANCE = "too few frames to exclude chance"
BESIDE = "disturbed: on the path of an object that other frames show"


@dataclass(frozen=True)
class Tracklet:
    """Object linked over n sources. ``frames``, ``rows``: (n,) frame of each source and row in the frame; ``times_s``
    (n,); ``icrs`` (n, 3); ``covariance_rad2`` (n, 2, 2) east and north; ``v_mag``, ``snr`` (n,); ``rate_rad_s`` (2,)
    east and north at the middle and its (2, 2) covariance; ``residual_rad`` (n, 2) from the fitted motion; ``chance``:
    expected number of such tracklets by accident; ``ends_icrs`` (n, 2, 3): directions at the start and the end of the
    exposure from both ends of the trail, and ``ends_sigma_rad`` (n, 2), NaN for points. The rate of a line in one frame
    is NaN and the order of its ends arbitrary."""

    frames: NDArray[np.intp]
    rows: NDArray[np.intp]
    times_s: Array
    icrs: Array
    covariance_rad2: Array
    v_mag: Array
    snr: Array
    rate_rad_s: Array
    rate_covariance: Array
    residual_rad: Array
    chance: float
    ends_icrs: Array
    ends_sigma_rad: Array

    def __len__(self) -> int:
        return len(self.times_s)

    @property
    def speed_rad_s(self) -> float:
        """Return the angular rate."""
        return float(np.hypot(*self.rate_rad_s))

    @property
    def rests(self) -> bool:
        """True if the motion is not significant."""
        if not np.isfinite(self.rate_covariance).all():
            return False
        return float(self.rate_rad_s @ np.linalg.solve(self.rate_covariance, self.rate_rad_s)) < REST_SIGMA**2


@dataclass(frozen=True)
class Linked:
    """Result for a sequence: ``moving`` and ``resting`` tracklets; ``streaks``: lines in a single frame; and per frame
    the (n,) reasons why a source is in none of these, "" if it is."""

    moving: list[Tracklet]
    resting: list[Tracklet]
    streaks: list[Tracklet]
    reasons: list[list[str]]


def link(
    frames: Sequence[FrameSpots], top_rate_rad_s: float, progress: Callable[[float], None] = lambda _: None
) -> Linked:
    """Link the sources of frames in order of time. ``top_rate_rad_s``: largest rate of an object."""
    reasons = [["" for _ in range(len(f))] for f in frames]
    for k, row in _fixed_on_detector(frames):
        reasons[k][row] = HOT
    for k, frame in enumerate(frames):
        for row in np.flatnonzero(frame.sharp).tolist():
            reasons[k][row] = reasons[k][row] or SHARP
    free = [np.array([r == "" for r in reason], bool) for reason in reasons]
    candidates = _candidates(frames, free, top_rate_rad_s, progress)
    moving: list[Tracklet] = []
    resting: list[Tracklet] = []
    used: set[tuple[int, int]] = set()
    doubtful: set[tuple[int, int]] = set()
    paths: list[SkyMotion] = []
    for hits, motion, chance in sorted(candidates, key=lambda c: (-len(c[0]), c[1].chi2)):
        hit_keys = {(h.frame, h.row) for h in hits}
        if hit_keys & used:
            continue
        if chance > MAX_CHANCE:
            doubtful |= hit_keys
            continue
        used |= hit_keys
        candidate = _tracklet(frames, hits, motion, chance)
        (resting if candidate.rests else moving).append(candidate)
        paths.append(motion)
    streaks = []
    for k, frame in enumerate(frames):
        for row in range(len(frame)):
            if (k, row) in used or reasons[k][row]:
                continue
            if _on_path(frame, row, paths):
                reasons[k][row] = BESIDE
            elif _is_streak(frame, row):
                streaks.append(_streak(frames, k, row))
            else:
                reasons[k][row] = CHANCE if (k, row) in doubtful else ONCE
    for tracklet in resting:
        for k, row in zip(tracklet.frames, tracklet.rows, strict=True):
            reasons[k][row] = REST
    return Linked(sorted(moving, key=lambda t: float(t.times_s[0])), resting, streaks, reasons)


def _fixed_on_detector(frames: Sequence[FrameSpots]) -> list[tuple[int, int]]:
    """Return (frame, row) of sources that stay at their pixel in three or more frames while the sky moves over the detector."""
    owner = [(k, row) for k, frame in enumerate(frames) for row in range(len(frame))]
    if len(owner) < MIN_HITS:
        return []
    pixels = np.concatenate([f.pixels for f in frames])
    icrs = np.concatenate([f.icrs for f in frames])
    frame_of = np.array([k for k, _ in owner])
    pixel_rad = frames[0].view.camera.pixel_rad
    owners = []
    for index, near in enumerate(cKDTree(pixels).query_ball_point(pixels, SAME_PIXEL_PX)):
        if len(set(frame_of[near])) < MIN_HITS:
            continue
        if float(separation_rad(icrs[near], icrs[index]).max()) > SKY_MOVED_PX * pixel_rad:
            owners.append(owner[index])
    return owners


def _candidates(
    frames: Sequence[FrameSpots],
    free: list[NDArray[np.bool_]],
    top_rate_rad_s: float,
    progress: Callable[[float], None],
) -> list[tuple[list[Hit], SkyMotion, float]]:
    """Return sources, motion and expected number of accidents of a tracklet from every pair that a third source supports."""
    seeds: list[tuple[Hit, Hit]] = []
    pairs = 0
    rows = [np.flatnonzero(f) for f in free]
    n = len(frames)
    for i in range(n):
        for j in range(i + 1, min(i + 1 + SEED_FRAMES, n)):
            step_s = frames[j].view.time_s - frames[i].view.time_s
            if not len(rows[i]) or not len(rows[j]) or step_s > MAX_STEP_S:
                continue
            first, second = frames[i].icrs[rows[i]], frames[j].icrs[rows[j]]
            apart = separation_rad(first[:, None], second[None])
            a, b = np.nonzero(apart <= top_rate_rad_s * step_s)
            pairs += len(a)
            for m, k in zip(a, b, strict=True):
                seeds.append((Hit(i, int(rows[i][m])), Hit(j, int(rows[j][k]))))
    seen: set[frozenset[Hit]] = set()
    candidates = []
    inside: set[tuple[Hit, Hit]] = set()
    for number, seed in enumerate(seeds):
        if number % 200 == 0:
            progress(number / len(seeds))
        if seed in inside:
            continue
        hits = _extended_both_ways(frames, rows, list(seed))
        if len(hits) < MIN_HITS or frozenset(hits) in seen:
            continue
        seen.add(frozenset(hits))
        inside |= {(a, b) for a in hits for b in hits if a.frame < b.frame}
        motion = fit_motion(frames, hits)
        if motion is not None and trail_agrees(frames, hits, motion):
            candidates.append((hits, motion, _chance(frames, rows, hits, motion, pairs)))
    return candidates


def _extended_both_ways(frames: Sequence[FrameSpots], rows: list[NDArray[np.intp]], hits: list[Hit]) -> list[Hit]:
    """Extend a pair to later frames, then to earlier frames."""
    hits = _extended(frames, rows, hits, range(hits[-1].frame + 1, len(frames)))
    if len(hits) < MIN_HITS:
        return hits
    return _extended(frames, rows, hits, range(hits[0].frame - 1, -1, -1))


def _extended(frames: Sequence[FrameSpots], rows: list[NDArray[np.intp]], hits: list[Hit], order: range) -> list[Hit]:
    misses = 0
    motion = fit_motion(frames, hits)
    for k in order:
        if motion is None or misses > (MAX_MISSES if len(hits) >= MIN_HITS else SEED_FRAMES - 1):
            break
        misses += 1
        if not len(rows[k]):
            continue
        frame = frames[k]
        if np.abs(motion.knots_s - frame.view.time_s).min() > MAX_STEP_S:
            break
        predicted, sigma_rad = motion.at(frame.view.time_s)
        gap = separation_rad(frame.icrs[rows[k]], predicted)
        best = int(np.argmin(gap / gate_rad(frame, rows[k], sigma_rad)))
        if gap[best] > gate_rad(frame, rows[k], sigma_rad)[best]:
            continue
        extended = sorted([*hits, Hit(k, int(rows[k][best]))])
        refit = fit_motion(frames, extended)
        if refit is not None and refit.sound:
            hits, motion, misses = extended, refit, 0
    return hits


def _chance(
    frames: Sequence[FrameSpots], rows: list[NDArray[np.intp]], hits: list[Hit], motion: SkyMotion, pairs: int
) -> float:
    """Return the expected number of tracklets with as many sources as this one in a sequence of unrelated sources."""
    camera = frames[0].view.camera
    field_rad2 = camera.columns * camera.rows * camera.pixel_rad**2
    expected = float(pairs)
    for number, hit in enumerate(hits[2:]):
        # The gate is widest when the motion is fitted to the fewest sources.
        sigma_rad = motion.slack_rad if number == 0 else 0.0
        gate = float(gate_rad(frames[hit.frame], np.array([hit.row]), sigma_rad)[0])
        expected *= min(1.0, len(rows[hit.frame]) * np.pi * gate**2 / field_rad2)
    return expected


def _tracklet(frames: Sequence[FrameSpots], hits: list[Hit], motion: SkyMotion, chance: float) -> Tracklet:
    index, rows = np.array([h.frame for h in hits]), np.array([h.row for h in hits])

    def column(name: str) -> Array:
        return np.array([getattr(frames[h.frame], name)[h.row] for h in hits])

    ends, sigma = column("ends_icrs"), column("ends_sigma_rad")
    drawn = np.asarray(column("trail_px").any(axis=1))
    # A trail has no direction. The motion between frames determines which end is the start.
    orders = [np.stack([ends[:, 0, 0], ends[:, 1, 1]], axis=1), np.stack([ends[:, 1, 0], ends[:, 0, 1]], axis=1)]
    along = [np.einsum("ni,ni->n", e[:, 1] - e[:, 0], motion.velocity) for e in orders]
    forward = along[0] >= along[1]
    ends = np.where(forward[:, None, None], *orders)
    sigma = np.where(forward[:, None], sigma, sigma[:, ::-1])
    ends, sigma = np.where(drawn[:, None, None], ends, np.nan), np.where(drawn[:, None], sigma, np.nan)
    return Tracklet(
        index,
        rows,
        np.array([frames[h.frame].view.time_s for h in hits]),
        column("icrs"),
        column("covariance_rad2"),
        column("v_mag"),
        column("snr"),
        motion.rate_rad_s,
        motion.rate_covariance,
        motion.residual_rad,
        chance,
        ends,
        sigma,
    )


def _on_path(frame: FrameSpots, row: int, paths: list[SkyMotion]) -> bool:
    """True if an object detected in other frames passes through this source."""
    at_s, reach_px = frame.view.time_s, 0.5 * float(np.hypot(*frame.trail_px[row])) + 2 * frame.star_sigma_px
    gap = [separation_rad(frame.icrs[row], p.at(at_s)[0]) for p in paths if p.covers(at_s)]
    return bool(gap) and float(min(gap)) < reach_px * frame.view.camera.pixel_rad


def _is_streak(frame: FrameSpots, row: int) -> bool:
    """True for a line in one frame that is long and not the trail of a star."""
    trail = frame.trail_px[row]
    star = star_trail_px(frame.view, frame.pixels[row][None])[0]
    min_length_px = STREAK_LENGTH * frame.star_sigma_px
    unlike = min(float(np.hypot(*(trail - star))), float(np.hypot(*(trail + star)))) > min_length_px
    return bool(float(np.hypot(*trail)) > min_length_px and unlike and frame.snr[row] > STREAK_SNR)


def _streak(frames: Sequence[FrameSpots], k: int, row: int) -> Tracklet:
    """Return the tracklet of a line in one frame. Its length gives the rate without sign."""
    frame = frames[k]
    single = np.array([row])
    nothing = np.full(2, np.nan)
    return Tracklet(
        np.array([k]),
        single,
        np.array([frame.view.time_s]),
        frame.icrs[single],
        frame.covariance_rad2[single],
        frame.v_mag[single],
        frame.snr[single],
        nothing,
        np.full((2, 2), np.nan),
        np.zeros((1, 2)),
        float("nan"),
        frame.ends_icrs[single][:, [0, 1], [0, 1]],
        frame.ends_sigma_rad[single],
    )
