"""Where the camera looks and what its field of view is, from four-star figures; then proof and calibration on the frame itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.domain.angles import Array
from gss.domain.camera import Brown, Camera
from gss.pipeline.identify.false_match import brightness_tail, false_match_probability, match_tail
from gss.pipeline.identify.patterns import Level, codes_of, radii_rad
from gss.pipeline.identify.pyramid import counted
from gss.pipeline.identify.verify import Sky, in_view, pair_up
from gss.pipeline.refine import Refined, refine

FOV_STEP = 1.22  # between field-of-view hypotheses where perspective matters
FLAT_FIELD_RAD = np.radians(13.0)  # below this all fields of view give the same figures
CODE_RADIUS = 0.014
SMALLEST_FIGURE = 0.06  # of the frame's width
ACCEPT = 1e-6
BATCHES = (8, 12, 16, 20)
PROBES = 14
WIDE_HALF_DIAGONAL_RAD = np.radians(12.0)
WIDE_STARS = 20
WIDE_LENS = ("k1", "k2", "p1", "p2")
MERGE_PX = 2.5
STRONG_HITS = 3
MOST_PROVED = 40
BRIGHTNESS_GATE_MAG = 1.8  # no filter, colour or saturation makes a star differ more from its neighbours
MAX_CANDIDATES = 40_000
MAX_FULL_CHECKS = 400
ACQUIRE = (0.003, 0.008)  # of the frame's width: a good lens, and one with strong distortion
# Coincidences are counted within these parts of the acquisition radius and among so many of the brightest detections;
# the best of all these counts is taken and pays for the others. Junk is mostly faint, and good lenses predict well.
COUNT_WITHIN = (1.0, 0.5, 0.2)
COUNT_AMONG = (8, 16, 40, 10_000)


@dataclass(frozen=True)
class Solved:
    """Accepted identification: rows of the detections and of the sky, with the fitted geometry."""

    rows: NDArray[np.intp]
    stars: NDArray[np.intp]
    fit: Refined
    predicted: int
    false_match_probability: float


@dataclass(frozen=True)
class BlindFound:
    """``solved`` or None with the reason; ``hypotheses``: candidates put to the test."""

    solved: Solved | None
    hypotheses: int
    reason: str = ""


@dataclass(frozen=True)
class _Candidate:
    camera: Camera
    cam_from_icrs: Array
    hits: int
    level: Level


def identify_blind(
    pixels: Array,
    magnitude: Array,
    sigma_px: Array,
    shape: tuple[int, int],
    fov_range_rad: tuple[float, float],
    sky: Sky,
    level: Callable[[float], Level],
    *,
    accept: float = ACCEPT,
) -> BlindFound:
    """Identify (n, 2) detections, brightest first, in a frame of (columns, rows) ``shape`` with square pixels.

    ``fov_range_rad``: (low, high) horizontal field of view; ``level(radius_rad)`` gives the dictionary of one size (the
    caller keeps them). Detections come with magnitudes of any zero point.
    """
    if len(pixels) < 5:
        return BlindFound(None, 0, f"{counted(len(pixels))} found: at least 5 are needed without a calibrated camera")
    search = _BlindSearch(pixels, magnitude, sigma_px, shape, fov_range_rad, sky, accept)
    for wanted in _rank_batches(len(pixels)):
        for fov in _fov_hypotheses(*fov_range_rad):
            solved = search.run(wanted, fov, level)
            if solved is not None:
                return BlindFound(solved, search.tried)
            if search.tried > MAX_CANDIDATES or search.full > MAX_FULL_CHECKS:
                return BlindFound(None, search.tried, _why(len(pixels), search.best, accept, "budget used up; "))
    return BlindFound(None, search.tried, _why(len(pixels), search.best, accept, ""))


class _BlindSearch:
    """Counts what was tried and remembers the best that was refused."""

    def __init__(
        self,
        pixels: Array,
        magnitude: Array,
        sigma_px: Array,
        shape: tuple[int, int],
        fov_range_rad: tuple[float, float],
        sky: Sky,
        accept: float,
    ) -> None:
        self.pixels, self.magnitude, self.sigma_px, self.shape = pixels, magnitude, sigma_px, shape
        self.limits, self.sky, self.accept = fov_range_rad, sky, accept
        self.tried = self.full = 0
        self.best: Solved | None = None

    def run(self, wanted: NDArray[np.int32], fov_rad: float, level: Callable[[float], Level]) -> Solved | None:
        """Test the figures ``wanted`` under one field of view, large circles first: they are few and quickly built."""
        columns, rows = self.shape
        ratio = min(1.0, rows / columns)
        window = _fov_window(fov_rad, self.limits)
        camera = replace(Camera.from_fov(columns, rows, fov_rad), distortion=Brown())
        unit = camera.unproject(self.pixels)
        codes, ids, size = codes_of(unit[wanted], wanted)
        span = np.linalg.norm(self.pixels[ids[:, 0]] - self.pixels[ids[:, 1]], axis=1)
        wide = span > SMALLEST_FIGURE * columns
        weak: list[_Candidate] = []
        for radius in reversed(radii_rad(window[0] * ratio, window[1] * ratio)):
            found, count = _look_up(
                level(radius), codes[wide], ids[wide], size[wide], camera, window, self.pixels, self.sky
            )
            self.tried += count
            solved = self._prove_first([c for c in found if c.hits >= STRONG_HITS])
            if solved is not None:
                return solved
            weak += [c for c in found if c.hits < STRONG_HITS]
        return self._prove_first(weak)

    def _prove_first(self, candidates: list[_Candidate]) -> Solved | None:
        for candidate in sorted(candidates, key=lambda c: -c.hits)[:MOST_PROVED]:
            self.full += 1
            solved = prove(
                candidate.camera,
                candidate.cam_from_icrs,
                self.pixels,
                self.magnitude,
                self.sigma_px,
                self.sky,
                max(self.tried, 1),
            )
            if solved is None:
                continue
            fov = solved.fit.camera.fov_rad[0]
            if not self.limits[0] * 0.97 < fov < self.limits[1] * 1.03:
                continue
            if solved.false_match_probability <= self.accept:
                return solved
            if self.best is None or solved.false_match_probability < self.best.false_match_probability:
                self.best = solved
        return None


def _why(n: int, best: Solved | None, accept: float, prefix: str) -> str:
    if best is None:
        return f"{prefix}none of the figures made of the brightest of {n} stars is in the sky at this field of view"
    return (
        f"{prefix}best candidate has {len(best.rows)} of {n} stars, but a false-match probability of "
        f"{best.false_match_probability:.1e} (limit {accept:.0e})"
    )


def _rank_batches(n: int) -> Iterator[NDArray[np.int32]]:
    """(q, 4) quadruples of detections, those of the brightest first; no quadruple twice."""
    done = 0
    for top in BATCHES:
        top_here = min(top, n)
        if top_here <= done:
            return
        rows = [q for q in combinations(range(top_here), 4) if q[3] >= done]
        done = top_here
        if rows:
            yield np.array(rows, np.int32)


def _fov_hypotheses(low: float, high: float) -> list[float]:
    out = []
    if low < FLAT_FIELD_RAD:
        out.append(float(np.sqrt(low * min(high, FLAT_FIELD_RAD))))
    edge = max(low, FLAT_FIELD_RAD)
    if high > edge:
        count = max(1, int(np.ceil(np.log(high / edge) / np.log(FOV_STEP))))
        step = (high / edge) ** (1 / count)
        out += [float(edge * step ** (k + 0.5)) for k in range(count)]
    return out


def _fov_window(fov: float, limits: tuple[float, float]) -> tuple[float, float]:
    """Range of true fields of view that one hypothesis answers for."""
    low, high = limits
    if fov < FLAT_FIELD_RAD:
        return low * 0.97, min(high, FLAT_FIELD_RAD) * 1.03
    return max(low * 0.97, fov / FOV_STEP), min(high * 1.03, fov * FOV_STEP)


def _look_up(
    level: Level,
    codes: Array,
    ids: NDArray[np.int32],
    size: Array,
    camera: Camera,
    window: tuple[float, float],
    pixels: Array,
    sky: Sky,
) -> tuple[list[_Candidate], int]:
    """Candidates of one level that at least one more star supports, and how many there were before that."""
    near = level.tree.query_ball_point(codes, CODE_RADIUS, return_sorted=False)
    count = np.fromiter((len(x) for x in near), np.intp, len(near))
    if not count.sum():
        return [], 0
    figure = np.repeat(np.arange(len(codes)), count)
    pattern = np.concatenate([np.asarray(x, np.intp) for x in near if x])
    # Sizes at the hypothesised focal length against true ones give the focal length.
    factor = size[figure] / level.size_rad[pattern]
    low, high = (np.tan(camera.fov_rad[0] / 2) / np.tan(w / 2) for w in (window[1], window[0]))
    ok = (factor > low) & (factor < high)
    figure, pattern, factor = figure[ok], pattern[ok], factor[ok]
    if not len(figure):
        return [], 0
    out = []
    for start in range(0, len(figure), 512):
        part = slice(start, start + 512)
        out += _probe(level, ids[figure[part]], pattern[part], factor[part], camera, pixels, sky)
    return out, len(figure)


def _probe(
    level: Level,
    ids: NDArray[np.int32],
    pattern: NDArray[np.intp],
    factor: Array,
    camera: Camera,
    pixels: Array,
    sky: Sky,
) -> list[_Candidate]:
    """Put the other bright detections on the sky with each candidate's attitude and count those that meet a star."""
    c = len(ids)
    probes = pixels[: min(PROBES, len(pixels))]
    focal = camera.focal_col_px * factor
    centre = np.array([camera.centre_col_px, camera.centre_row_px])

    def rays(points: Array) -> Array:
        xy = (points - centre) / focal[:, None, None]
        v = np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)
        return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))

    seen, known = rays(pixels[ids]), sky.icrs[level.stars[pattern]]
    u, _, vt = np.linalg.svd(np.einsum("cki,ckj->cij", seen, known))
    sign = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    u[:, :, 2] *= sign[:, None]
    rotation = u @ vt
    others = np.einsum("cji,ckj->cki", rotation, rays(np.broadcast_to(probes, (c, *probes.shape))))
    reach = 0.008 * camera.columns / focal
    distance, _ = level.bright.query(others.reshape(-1, 3), distance_upper_bound=float(reach.max()))
    hit = distance.reshape(c, -1) < reach[:, None]
    own = (ids[:, :, None] == np.arange(len(probes))).any(1)
    hits = (hit & ~own).sum(1)
    free = (~own).sum(1)
    need = np.where(free <= 4, 1, 2)
    return [
        _Candidate(camera.with_focal_scaled(float(factor[k])), rotation[k], int(hits[k]), level)
        for k in np.flatnonzero(hits >= need)
    ]


def prove(
    camera: Camera, cam_from_icrs: Array, pixels: Array, magnitude: Array, sigma_px: Array, sky: Sky, hypotheses: float
) -> Solved | None:
    """Match and refine in turn from a narrow and from a wide acquisition radius; the more certain of the two."""
    results = [
        _prove(camera, cam_from_icrs, pixels, magnitude, sigma_px, sky, hypotheses, part * camera.columns)
        for part in ACQUIRE
    ]
    good = [r for r in results if r is not None]
    return min(good, key=lambda r: r.false_match_probability) if good else None


def _is_wide(camera: Camera) -> bool:
    """Whether decentring and higher orders of the lens show."""
    return bool(camera.half_diagonal_rad > WIDE_HALF_DIAGONAL_RAD)


def _visible(sky: Sky, camera: Camera, cam_from_icrs: Array, wanted: int) -> tuple[NDArray[np.intp], Array]:
    """The brightest ``wanted`` stars in view and their pixels, without faint companions that melt into a brighter star."""
    rows, pixels = in_view(sky, camera, cam_from_icrs)
    rows, pixels = rows[:wanted], pixels[:wanted]
    keep = np.ones(len(rows), bool)
    if len(rows) > 1:
        keep[cKDTree(pixels).query_pairs(MERGE_PX, output_type="ndarray").max(axis=1)] = False
    return rows[keep], pixels[keep]


def _prove(
    camera: Camera,
    cam_from_icrs: Array,
    pixels: Array,
    magnitude: Array,
    sigma_px: Array,
    sky: Sky,
    hypotheses: float,
    acquire_px: float,
) -> Solved | None:
    wanted = int(1.5 * len(pixels)) + 5
    sigma = np.maximum(sigma_px, 0.15)
    radius = acquire_px
    fit = Refined(camera, cam_from_icrs, np.zeros((0, 2)), np.zeros(0), np.eye(3), radius)
    first, expected = np.zeros((0, 2)), 0
    for round_ in range(6):
        seen, predicted = _visible(sky, fit.camera, fit.cam_from_icrs, wanted)
        if len(seen) < 4:
            return None
        p, m = pair_up(predicted, pixels, np.full(len(seen), radius))
        if len(m) < 5:
            return None
        if round_ == 0:
            first = np.full((len(sky), 2), np.inf)
            first[seen] = predicted
            expected = len(seen)
        try:
            lens = WIDE_LENS if len(m) >= WIDE_STARS and round_ >= 2 and _is_wide(fit.camera) else ("k1",)
            fit = refine(
                pixels[m], sky.icrs[seen[p]], sigma[m], fit.camera, fit.cam_from_icrs, fit_focal=True, fit_lens=lens
            )
        except np.linalg.LinAlgError:
            return None
        if not np.isfinite(fit.rms_px):
            return None
        radius = (
            float(np.clip(4.0 * fit.rms_px, 0.8, max(acquire_px * 0.7, 0.8)))
            if round_ < 3
            else float(np.clip(3.5 * fit.rms_px, 0.7, 3.5))
        )
    difference = magnitude[m] - sky.v_mag[seen[p]]
    keep = (fit.weight > 0) & (np.abs(difference - np.median(difference)) < BRIGHTNESS_GATE_MAG)
    rows, stars = m[keep], seen[p][keep]
    if len(rows) < 5 or not _plausible(fit):
        return None
    spread = float(np.hypot(np.std(sky.v_mag[seen]), np.std(magnitude)))
    brightness = brightness_tail(magnitude[rows], sky.v_mag[stars], spread)
    offset = np.linalg.norm(first[stars] - pixels[rows], axis=1)
    tail = _tail(rows, offset, acquire_px, expected, len(pixels), camera, brightness)
    fit = replace(fit, residual_px=fit.residual_px[keep], weight=fit.weight[keep])
    return Solved(rows, stars, fit, len(seen), false_match_probability(hypotheses, tail))


def _tail(
    rows: NDArray[np.intp],
    offset: Array,
    acquire_px: float,
    expected: int,
    detections: int,
    camera: Camera,
    brightness: float,
) -> float:
    """Chance that detections scattered at random meet the first prediction so often.

    ``offset``: (m,) px of the matched detections ``rows`` before any fit could pull stars together. Four are used up by the figure.
    """
    area_px2 = camera.columns * camera.rows
    tails = []
    for part in COUNT_WITHIN:
        radius = part * acquire_px
        chance = min(1.0, expected * np.pi * radius**2 / area_px2)
        for among in COUNT_AMONG:
            met = int(((offset <= radius) & (rows < among)).sum())
            tails.append(match_tail(met - 4, max(min(detections, among) - 4, 0), chance, brightness))
    return min(1.0, min(tails) * len(tails) * len(ACQUIRE))


def _plausible(fit: Refined) -> bool:
    """A lens that bends its corners by more than a fifth is no fit but an accident."""
    k1 = fit.camera.distortion.k1 if isinstance(fit.camera.distortion, Brown) else 0.0
    return abs(k1) * np.tan(min(fit.camera.half_diagonal_rad, 1.2)) ** 2 < 0.2 and fit.rms_px < 3.0
