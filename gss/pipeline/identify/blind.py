"""Blind identification: pointing and field of view from four-star figures, then verification and calibration on the same frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Brown, Camera
from gss.pipeline.identify.blind_candidates import Candidate, look_up
from gss.pipeline.identify.blind_proof import BlindSolution, prove
from gss.pipeline.identify.faint import Rows, Spots, match_all
from gss.pipeline.identify.false_match import not_credible
from gss.pipeline.identify.patterns import PatternLevel, codes_of, radii_rad
from gss.pipeline.identify.pyramid import counted
from gss.pipeline.identify.verify import SkyCatalogue
from gss.pipeline.lens import fit_lens
from gss.pipeline.refine import Refined

FOV_STEP = 1.22  # ratio between field-of-view hypotheses if perspective matters
FLAT_FIELD_RAD = np.radians(13.0)  # below this angle, figures do not depend on the field of view
MIN_FIGURE = 0.06  # of the frame's width
ACCEPT = 1e-6
BATCHES = (8, 12, 16, 20)
MIN_SIGMA_PX = 0.03  # no lens calibration is better than this
STRONG_HITS = 3
MAX_PROVED = 40
MAX_CANDIDATES = 40_000
MAX_FULL_CHECKS = 400
MAX_UNSETTLED = 15  # maximum number of verified pointings for which no lens fits the single stars
NO_LENS = (
    "the pointing was identified, but no lens fits the single stars: "
    "the pixels are possibly not square, or the optical axis is far from the middle"
)


@dataclass(frozen=True)
class Guess:
    """Assumed camera geometry, except for the field of view. ``aspect``: vertical divided by horizontal focal length.
    ``right``, ``down``: offset of the optical axis from the frame's middle, as a share of the width."""

    aspect: float = 1.0
    right: float = 0.0
    down: float = 0.0

    def camera(self, columns: int, rows: int, fov_rad: float) -> Camera:
        """Return a camera with this geometry and a Brown lens, which can be fitted."""
        plain = Camera.from_fov(columns, rows, fov_rad)
        return replace(
            plain,
            focal_row_px=plain.focal_row_px * self.aspect,
            centre_col_px=plain.centre_col_px + self.right * columns,
            centre_row_px=plain.centre_row_px + self.down * columns,
            distortion=Brown(),
        )


SQUARE = Guess()
# The steps are small enough for figures to keep their codes. The fit in the verification corrects the remaining
# difference.
ASPECTS = tuple(Guess(aspect=1.05 ** (sign * k)) for k in range(1, 7) for sign in (1, -1))
CENTRES = tuple(
    Guess(right=float(off * np.cos(turn)), down=float(off * np.sin(turn)))
    for off in (0.12, 0.24)
    for turn in np.arange(8) * np.pi / 4
)
ALSO = ("aspect", "col", "row")
MAX_ODD_CHECKS = 120  # limit on the number of verifications for all these guesses together
WIDE_RAD = np.radians(30.0)
FULLER_ROUNDS = 3
LOOSE, BETTER, FAR_BETTER = 1.5, 0.9, 0.5
THIN, THIN_AMONG = 0.5, 24
ODD_BATCHES = 2  # only figures of the brightest stars, because many geometries are tried


@dataclass(frozen=True)
class BlindResult:
    """Result of a blind search. ``solved``: the solution, or None with a ``reason``. ``hypotheses``: number of
    candidates tested. ``placed``: True if the pointing was verified, even if no lens fits the single stars."""

    solved: BlindSolution | None
    hypotheses: int
    reason: str = ""
    placed: bool = False


def identify_blind(
    spots: Spots,
    shape: tuple[int, int],
    fov_range_rad: tuple[float, float],
    sky: SkyCatalogue,
    level: Callable[[float], PatternLevel],
    *,
    accept: float = ACCEPT,
    odd: bool = True,
) -> BlindResult:
    """Identify detections, brightest first, in a frame of (columns, rows) ``shape``.

    A camera with square pixels and a centred optical axis is tried first. If ``odd``, non-square pixels and off-centre
    axes are tried next.

    ``fov_range_rad``: (low, high) horizontal field of view; ``level(radius_rad)`` returns the dictionary of one size
    (the caller caches them). The result contains every star that can be identified, not only the stars used in the
    verification.
    """
    n = len(spots.pixels)
    if n < 5:
        return BlindResult(None, 0, f"{counted(n)} found: at least 5 are needed without a calibrated camera")
    search = _BlindSearch(spots, shape, fov_range_rad, sky, accept)
    batches = list(_rank_batches(n))
    plain = _search(search, batches, level)
    if not odd or (plain.solved is not None and not search.is_doubtful(plain.solved)):
        return plain
    for guess in (SQUARE, *ASPECTS, *CENTRES):
        search.suppose(guess)
        solution = _search(search, batches[:ODD_BATCHES], level)
        if solution.solved is not None and (plain.solved is None or _is_better(solution.solved, plain.solved)):
            return solution
        if search.tried > MAX_CANDIDATES or search.full > MAX_ODD_CHECKS:
            break
    return replace(plain, hypotheses=search.tried)


def _search(
    search: _BlindSearch, batches: list[NDArray[np.int32]], level: Callable[[float], PatternLevel]
) -> BlindResult:
    """Test all figures under all fields of view, within the limits on the number of candidates."""
    for batch in batches:
        for fov in _fov_hypotheses(*search.limits):
            solved = search.run(batch, fov, level)
            if solved is not None:
                return BlindResult(solved, search.tried, placed=True)
            if search.unsettled >= MAX_UNSETTLED:
                return BlindResult(None, search.tried, search.why(""), placed=True)
            if search.tried > MAX_CANDIDATES or search.full > MAX_FULL_CHECKS:
                return BlindResult(None, search.tried, search.why("budget used up; "), search.unsettled > 0)
    return BlindResult(None, search.tried, search.why(""), search.unsettled > 0)


class _BlindSearch:
    """State of a search: number of candidates tested, and best rejected candidate."""

    def __init__(
        self,
        spots: Spots,
        shape: tuple[int, int],
        fov_range_rad: tuple[float, float],
        sky: SkyCatalogue,
        accept: float,
    ) -> None:
        self.spots, self.pixels, self.shape = spots, spots.pixels, shape
        self.limits, self.sky, self.accept = fov_range_rad, sky, accept
        self.tried = self.full = 0
        self.best: BlindSolution | None = None
        self.unsettled = 0
        self.guess, self.also = SQUARE, tuple[str, ...]()

    def suppose(self, guess: Guess) -> None:
        """Switch to another camera geometry without resetting the number of candidates tested."""
        if not self.also:
            self.full = 0
        self.guess, self.also = guess, ALSO
        self.unsettled = 0

    def run(
        self, pattern_rows: NDArray[np.int32], fov_rad: float, level: Callable[[float], PatternLevel]
    ) -> BlindSolution | None:
        """Test the figures ``pattern_rows`` under one field of view. Large circles are first, because they are few and
        quick to build."""
        columns, rows = self.shape
        ratio = min(1.0, rows / columns)
        window = _fov_window(fov_rad, self.limits)
        camera = self.guess.camera(columns, rows, fov_rad)
        unit = camera.unproject(self.pixels)
        codes, ids, size = codes_of(unit[pattern_rows], pattern_rows)
        span = np.linalg.norm(self.pixels[ids[:, 0]] - self.pixels[ids[:, 1]], axis=1)
        wide = span > MIN_FIGURE * columns
        weak: list[Candidate] = []
        for radius in reversed(radii_rad(window[0] * ratio, window[1] * ratio)):
            candidates, count = look_up(
                level(radius), codes[wide], ids[wide], size[wide], camera, window, self.pixels, self.sky
            )
            self.tried += count
            solved = self._prove_first([c for c in candidates if c.hits >= STRONG_HITS])
            if solved is not None:
                return solved
            weak += [c for c in candidates if c.hits < STRONG_HITS]
        return self._prove_first(weak)

    def _prove_first(self, candidates: list[Candidate]) -> BlindSolution | None:
        for candidate in sorted(candidates, key=lambda c: -c.hits)[:MAX_PROVED]:
            self.full += 1
            solved = prove(
                candidate.camera,
                candidate.cam_from_icrs,
                self.pixels,
                self.spots.magnitude,
                self.spots.sigma_px,
                self.sky,
                max(self.tried, 1),
                self.also,
            )
            if solved is None:
                continue
            fov = solved.fit.camera.fov_rad[0]
            if not self.limits[0] * 0.97 < fov < self.limits[1] * 1.03:
                continue
            if solved.false_match_probability <= self.accept:
                settled = self._settle(solved)
                if settled is not None:
                    return settled
                self.unsettled += 1
                if self.unsettled >= MAX_UNSETTLED:
                    return None
                continue
            if self.best is None or solved.false_match_probability < self.best.false_match_probability:
                self.best = solved
        return None

    def _settle(self, solved: BlindSolution) -> BlindSolution | None:
        """Fit lens and attitude to all stars that can be identified. None if the first fit was wrong because of strong
        distortion."""
        settled = self._name(solved, self.also)
        for _ in range(FULLER_ROUNDS):
            if settled is None or not self._is_loose(settled):
                break
            fuller = self._name(settled, ALSO)
            if fuller is None or not _is_better(fuller, settled):
                break
            # A standard camera is replaced only by a camera that fits all detections and has far smaller residuals,
            # because real lenses have more terms than are fitted.
            if not self.also and (self._is_loose(fuller) or fuller.fit.rms_px > FAR_BETTER * settled.fit.rms_px):
                break
            settled = fuller
        # A camera with this number of free parameters must fit all detections; otherwise it could fit any frame.
        return None if settled is not None and self.also and self._is_loose(settled) else settled

    def _name(self, solved: BlindSolution, also: tuple[str, ...]) -> BlindSolution | None:
        spots = replace(self.spots, sigma_px=np.maximum(self.spots.sigma_px, MIN_SIGMA_PX))
        start = solved.fit

        def fit_to(rows: Rows, stars_of_rows: Rows, sigma_px: Array) -> Refined:
            return fit_lens(
                spots.pixels[rows], self.sky.icrs[stars_of_rows], sigma_px, start.camera, start.cam_from_icrs, also
            )

        matches = match_all(spots, self.sky, start, solved.rows, solved.stars, fit_to)
        return None if matches is None else replace(solved, rows=matches.rows, stars=matches.stars, fit=matches.fit)

    def _is_loose(self, settled: BlindSolution) -> bool:
        """True if the camera does not explain the detections: too few are identified, or the residuals exceed their errors."""
        sigma_px = np.maximum(self.spots.sigma_px[settled.rows], MIN_SIGMA_PX)
        return self.is_thin(settled) or settled.fit.rms_px > LOOSE * float(np.median(sigma_px))

    def is_thin(self, settled: BlindSolution) -> bool:
        """True if too few of the bright detections are identified for a correct camera."""
        among = min(len(self.pixels), THIN_AMONG)
        return int((settled.rows < among).sum()) < THIN * among

    def is_doubtful(self, settled: BlindSolution) -> bool:
        """True if only few stars of a wide field are identified, so the optical axis can be off-centre. In a narrow
        field, the position of the axis has no effect."""
        return settled.fit.camera.fov_rad[0] > WIDE_RAD and self.is_thin(settled)

    def why(self, prefix: str) -> str:
        """Return the reason why the search ended without a solution."""
        n, best = len(self.pixels), self.best
        if self.unsettled:
            return f"{prefix}{NO_LENS}"
        if best is None:
            return f"{prefix}no figure of the brightest of {n} stars matches the sky at this field of view"
        return prefix + not_credible(len(best.rows), n, best.false_match_probability, self.accept)


def _is_better(fuller: BlindSolution, settled: BlindSolution) -> bool:
    """True if ``fuller`` identifies more stars, or the same number with clearly smaller residuals."""
    extra = len(fuller.rows) - len(settled.rows)
    return extra > 0 or (extra == 0 and fuller.fit.rms_px < BETTER * settled.fit.rms_px)


def _rank_batches(n: int) -> Iterator[NDArray[np.int32]]:
    """Yield (q, 4) quadruples of detections without repetition. Quadruples of the brightest detections come first."""
    yielded = 0
    for top in BATCHES:
        top_here = min(top, n)
        if top_here <= yielded:
            return
        rows = [q for q in combinations(range(top_here), 4) if q[3] >= yielded]
        yielded = top_here
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
    """Return the range of true fields of view that one hypothesis covers."""
    low, high = limits
    if fov < FLAT_FIELD_RAD:
        return low * 0.97, min(high, FLAT_FIELD_RAD) * 1.03
    return max(low * 0.97, fov / FOV_STEP), min(high * 1.03, fov * FOV_STEP)
