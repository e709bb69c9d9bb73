"""The chain of CubeStar (Erlank 2013 ch. 4–5): plane search, 5x5 centroids, geometric voting, QUEST.

The same functions run in the simulator's firmware and on the ground, and :func:`solve` composes exactly the single steps
that the device offers as commands. Nothing depends on time; the same frame, bank and parameters give the same bits.

What the document leaves open, and what we add against false attitudes, is said at each parameter in ``SOURCES``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from gss.domain.angles import Array
from gss.domain.camera import Brown, BrownUndistort, Camera
from gss.domain.errors import BadInput
from gss.domain.profiles import CameraProfile
from gss.domain.results import Attitude, Centroids, Matches, Outcome, Region, SolveResult
from gss.domain.rotation import matrix_from_quaternion
from gss.domain.sensor import Sensor
from gss.domain.stars import OnboardCatalogue
from gss.pipeline.attitude import quest, weighted_covariance_rad2
from gss.pipeline.centroid import PixelNoise, brightest_first, window_centroids
from gss.pipeline.identify.geometric_voting import (
    Mask,
    Rows,
    agreement,
    cluster,
    mutually_consistent,
    pairs_of,
    reduced_table,
    vote,
)
from gss.pipeline.regions import Pixels, SearchLimits, grid_median_dn, region_records, search
from gss.pipeline.trace import Trace
from gss.pipeline.track.nearest import match_nearest

NAME = "cubestar"

SOURCES: dict[str, str] = {
    "threshold_dn": "Erlank 2013 §5.3.3 gives 6 above black for its own camera and a semi-urban sky; ours is raised until "
    "a star 0.25 mag below the catalogue's limit covers min_area_px no longer, so that the frame shows what the bank holds",
    "min_area_px": "Erlank 2013 §5.3.3: six",
    "max_area_px": "Erlank 2013 §5.3.3: sixty",
    "max_invalid": "Erlank 2013 §5.3.3: search stops at more than fifty",
    "max_centroids": "Erlank 2013 §5.3.3–4: twenty",
    "edge_rule": "Jacobs 1995 §2.2.3, as Erlank 2013 §4.1.2 takes over its region growing: a cut star's centroid is 0.9 px off",
    "search_step_px": "Erlank 2013 §4.1.1: every third pixel of every third row",
    "window_px": "Erlank 2013 §4.1.3: 5 x 5",
    "tolerance_rad": "Erlank 2013 §4.3.5: 0.001 rad, about one pixel; other cameras: 1.12 pixels as well",
    "vote_margin": "Erlank 2013 §4.3.3: within one of the most votes",
    "min_verified": "ours: four without knowledge, three with a hint, two in tracking (Erlank 2013 §4.5 asks for two)",
    "max_false_probability": "ours: largest accepted bound on the chance of an accidental identification",
    "tracking_radius_rad": "Erlank 2013 §4.5: 0.3°",
    "assisted_radius_rad": "Erlank 2013 §4.3.4: 35°; other cameras: half diagonal + 5°",
    "undistort": "exact inverse of the camera's model; 'document' is Erlank 2013 eq. 4.1.3–4 with inverted signs",
    "noise": "from the profile's sensor; the floor of 0.05 px is the size of Erlank 2013 §4.1.6's errors without noise",
}


class Mode(StrEnum):
    """How much is known before. ``state`` is the flag in the device's flash (Erlank 2013 §5.3.4)."""

    LOST_IN_SPACE = "lost_in_space"
    ASSISTED = "assisted"
    TRACKING = "tracking"

    @property
    def state(self) -> int:
        """2 lost in space, 1 assisted, 0 tracking."""
        return {Mode.LOST_IN_SPACE: 2, Mode.ASSISTED: 1, Mode.TRACKING: 0}[self]

    @classmethod
    def from_state(cls, state: int) -> Mode:
        """The mode of a flag."""
        try:
            return (cls.TRACKING, cls.ASSISTED, cls.LOST_IN_SPACE)[state]
        except IndexError:
            raise BadInput("unknown tracking state", expected="0, 1 or 2", got=str(state)) from None


def next_mode(mode: Mode, solved: bool) -> Mode:
    """The mode of the next iteration: an attitude leads to tracking, each failure one step back.

    The document says only that the result of the attitude determination sets the flag (§5.3.4) and asks for better rules
    (§7.2); a failed tracking frame still has a good boresight from before, hence assisted before lost.
    """
    if solved:
        return Mode.TRACKING
    return Mode.ASSISTED if mode is Mode.TRACKING else Mode.LOST_IN_SPACE


@dataclass(frozen=True)
class Hint:
    """What is known about the attitude: (3,) boresight in ICRS, and the (4,) quaternion cam_from_icrs if all of it."""

    boresight_icrs: Array
    quaternion: Array | None = None

    @classmethod
    def from_quaternion(cls, quaternion: Array) -> Hint:
        """Full attitude."""
        q = np.asarray(quaternion, float)
        return cls(matrix_from_quaternion(q)[2], q)


@dataclass(frozen=True)
class CubestarParameters:
    """Constants of the chain; ``SOURCES`` says where each comes from. ``threshold_dn`` is above the frame's black level."""

    threshold_dn: float
    tolerance_rad: float
    assisted_radius_rad: float
    noise: PixelNoise
    min_area_px: int = 6
    max_area_px: int = 60
    max_invalid: int = 50
    max_centroids: int = 20
    edge_rule: bool = True
    search_step_px: int = 3
    window_px: int = 5
    vote_margin: int = 1
    min_verified_lost: int = 4
    min_verified_assisted: int = 3
    min_verified_tracking: int = 2
    max_false_probability: float = 1e-3
    tracking_radius_rad: float = float(np.radians(0.3))
    undistort: str = "exact"
    max_small_regions: int = 100

    def __post_init__(self) -> None:
        if self.undistort not in ("exact", "document"):
            raise BadInput("unknown way to undistort", expected="exact | document", got=self.undistort)
        if not (self.threshold_dn > 0 and self.tolerance_rad > 0 and 1 <= self.min_area_px <= self.max_area_px):
            raise BadInput(
                "detection parameters are impossible",
                expected="threshold and tolerance above zero, 1 ≤ smallest ≤ largest area",
                got=f"{self.threshold_dn}, {self.tolerance_rad}, {self.min_area_px}, {self.max_area_px}",
            )

    def min_verified(self, mode: Mode) -> int:
        """Fewest verified stars for an attitude."""
        if mode is Mode.TRACKING:
            return self.min_verified_tracking
        return self.min_verified_assisted if mode is Mode.ASSISTED else self.min_verified_lost


FAINTER_MAG = 0.25
DOCUMENT_THRESHOLD_DN = 6.0
DOCUMENT_RADIUS_RAD = float(np.radians(35.0))
NOISE_SIGMAS = 4.0
TOLERANCE_PX = 0.001 * 6.28 / 0.0056
HINT_ERROR_RAD = float(np.radians(5.0))


def default_parameters(profile: CameraProfile, exposure_s: float | None = None) -> CubestarParameters:
    """Parameters for a camera: the document's numbers where they are pixels and counts, scaled where they are angles."""
    sensor, camera = profile.sensor, profile.camera
    exposure = sensor.exposure_s if exposure_s is None else exposure_s
    noise_dn = sensor.noise_e(exposure) / sensor.gain_e_per_dn
    own_radius_rad = DOCUMENT_RADIUS_RAD if profile.name == NAME else 0.0
    return CubestarParameters(
        threshold_dn=max(
            DOCUMENT_THRESHOLD_DN,
            round(NOISE_SIGMAS * noise_dn),
            round(_level_where_faintest_vanishes_dn(sensor, exposure)),
        ),
        tolerance_rad=TOLERANCE_PX * camera.pixel_rad,
        assisted_radius_rad=max(own_radius_rad, camera.half_diagonal_rad + HINT_ERROR_RAD),
        noise=PixelNoise(noise_dn, sensor.gain_e_per_dn, 0.05),
    )


def _level_where_faintest_vanishes_dn(sensor: Sensor, exposure_s: float) -> float:
    """Level above which a Gaussian star just below the limiting magnitude covers six pixels: 2πσ² ln(peak / level) = 6."""
    spread_px2 = 2 * np.pi * (sensor.psf_sigma_px**2 + 1 / 12)
    star_dn = float(sensor.star_e(sensor.faint_limit_mag + FAINTER_MAG, exposure_s)) / sensor.gain_e_per_dn
    return float(star_dn / spread_px2 * np.exp(-6 / spread_px2))


@dataclass(frozen=True)
class Detection:
    """FIND_CENTROIDS. ``regions`` in order of discovery, ``centroids`` brightest first and at most ``max_centroids``;
    ``invalid``: too large regions; ``black_dn``: the level the threshold was counted from."""

    regions: tuple[Region, ...]
    centroids: Centroids
    invalid: int
    black_dn: float
    notes: tuple[str, ...] = ()


def find_centroids(pixels: Pixels, parameters: CubestarParameters) -> Detection:
    """Stars in a (rows, columns) frame (Erlank 2013 §4.1, §5.3.3).

    The chip subtracts the mean of its masked rows, so that black is zero (§3.4.4). Foreign frames do not come that way: the
    median of the search grid stands in for it, in the threshold as in the centroid's weights.
    """
    p = parameters
    black_dn = grid_median_dn(pixels, p.search_step_px)
    limits = SearchLimits(p.min_area_px, p.max_area_px, p.max_invalid, p.max_centroids, p.edge_rule)
    found = search(pixels, black_dn + p.threshold_dn, limits, p.search_step_px)
    stars = found.blobs.take(found.accepted)
    centroids = window_centroids(pixels, stars, black_dn, p.threshold_dn, p.window_px, p.noise)
    return Detection(
        region_records(pixels, found, black_dn, p.max_small_regions),
        centroids.take(brightest_first(centroids)),
        found.invalid,
        black_dn,
        (found.stopped,) if found.stopped else (),
    )


def unit_vectors(centroids: Centroids, camera: Camera, undistort: str = "exact") -> Array:
    """(n, 3) camera-frame directions (Erlank 2013 eq. 4.1.3–6)."""
    if undistort == "document":
        camera = replace(camera, distortion=document_distortion(camera))
    return camera.unproject(centroids.pixels)


def document_distortion(camera: Camera) -> BrownUndistort:
    """The device's own approximation: Brown's polynomial from measured to ideal with the toolbox signs inverted."""
    d = camera.distortion
    if not isinstance(d, Brown):
        raise BadInput(
            "the document's correction needs Brown coefficients", expected="Brown distortion", got=type(d).__name__
        )
    return BrownUndistort(-d.k1, -d.k2, -d.p1, -d.p2)


@dataclass(frozen=True)
class Matching:
    """MATCH_STARS. Per centroid used, (n,): ``row`` most voted catalogue row or −1, ``first_votes``, ``verification_votes``.
    ``selected``: centroids that go into the attitude, empty with a ``reason``. ``searched``: stars in the (reduced)
    catalogue; ``hits``: table entries met; ``predicted_cam`` only while tracking."""

    mode: Mode
    unit_cam: Array
    row: Rows
    first_votes: Rows
    verification_votes: NDArray[np.int64]
    selected: Rows
    searched: int
    hits: int
    reason: str

    @property
    def confidence(self) -> float:
        """Mean verification votes of the selected stars over the most possible, 0 without any."""
        most = len(self.row) - 1
        return float(np.mean(self.verification_votes[self.selected]) / most) if len(self.selected) and most else 0.0


def match_stars(
    centroids: Centroids,
    camera: Camera,
    catalogue: OnboardCatalogue,
    parameters: CubestarParameters,
    mode: Mode = Mode.LOST_IN_SPACE,
    hint: Hint | None = None,
) -> Matching:
    """Names for centroids (Erlank 2013 §4.3–4.5). Only the first ``max_centroids`` are looked at."""
    _check_hint(mode, hint)
    used = centroids.take(np.arange(min(len(centroids), parameters.max_centroids)))
    unit = unit_vectors(used, camera, parameters.undistort)
    # A centroid outside the distortion's domain has no direction; it keeps its place but takes no part.
    good = np.flatnonzero(np.isfinite(unit).all(axis=1))
    allowed = _allowed(catalogue, mode, hint, parameters)
    pairs = pairs_of(unit[good])
    row, first_votes = np.full(len(unit), -1, np.intp), np.zeros(len(unit), np.intp)
    hits = 0
    if mode is Mode.TRACKING:
        row[good] = _tracked(unit[good], catalogue, allowed, hint, parameters)
        first_votes[good] = row[good] >= 0
    else:
        table = catalogue.distances if mode is Mode.LOST_IN_SPACE else reduced_table(catalogue.distances, allowed)
        ballot = vote(pairs, len(good), table, len(catalogue), parameters.tolerance_rad)
        row[good], first_votes[good], hits = ballot.row, ballot.votes, ballot.hits
    agree = agreement(pairs, row[good], catalogue, parameters.tolerance_rad)
    votes = np.zeros(len(unit), np.int64)
    votes[good] = agree.sum(axis=1)
    selected = good[mutually_consistent(agree, cluster(votes[good], parameters.vote_margin))]
    reason = _too_few(len(unit), len(selected), parameters.min_verified(mode), mode)
    selected = selected if not reason else selected[:0]
    return Matching(mode, unit, row, first_votes, votes, selected, int(np.count_nonzero(allowed)), hits, reason)


def _check_hint(mode: Mode, hint: Hint | None) -> None:
    if mode is Mode.LOST_IN_SPACE:
        return
    if hint is None or (mode is Mode.TRACKING and hint.quaternion is None):
        need = "a full attitude" if mode is Mode.TRACKING else "a boresight or an attitude"
        raise BadInput(f"{mode.value} needs a hint", expected=need, got="none" if hint is None else "a boresight only")


def _allowed(catalogue: OnboardCatalogue, mode: Mode, hint: Hint | None, parameters: CubestarParameters) -> Mask:
    """The reduced catalogue: stars within D_max of the rough boresight (Erlank 2013 §4.3.4); all when lost."""
    if mode is Mode.LOST_IN_SPACE or hint is None:
        return np.ones(len(catalogue), bool)
    boresight = np.asarray(hint.boresight_icrs, float)
    cosine = catalogue.icrs.astype(float) @ (boresight / np.linalg.norm(boresight))
    return np.asarray(cosine >= np.cos(parameters.assisted_radius_rad))


def _tracked(
    unit: Array, catalogue: OnboardCatalogue, allowed: Mask, hint: Hint | None, parameters: CubestarParameters
) -> Rows:
    if hint is None or hint.quaternion is None:
        return np.full(len(unit), -1, np.intp)
    predicted = catalogue.icrs.astype(float) @ matrix_from_quaternion(hint.quaternion).T
    return match_nearest(unit, predicted, allowed, parameters.tracking_radius_rad)


def _too_few(centroids: int, verified: int, needed: int, mode: Mode) -> str:
    if centroids == 0:
        return "no star found in the frame"
    if verified >= needed:
        return ""
    stars = "centroid" if centroids == 1 else "centroids"
    return f"{verified} of {centroids} {stars} verified; {needed} needed in {mode.value.replace('_', ' ')} mode"


@dataclass(frozen=True)
class Solution:
    """CALCULATE_ATTITUDE. ``attitude`` and ``matches`` are None with a ``reason``. ``false_match_probability``: bound on
    the chance that an accidental identification of this quality turns up; NaN where nothing was identified."""

    attitude: Attitude | None
    matches: Matches | None
    false_match_probability: float
    reason: str


def calculate_attitude(
    matching: Matching,
    centroids: Centroids,
    camera: Camera,
    catalogue: OnboardCatalogue,
    parameters: CubestarParameters,
    hint: Hint | None = None,
) -> Solution:
    """QUEST over the selected stars with their verification votes as weights (Erlank 2013 §4.4, §5.3.4), and the checks
    that keep a false attitude from leaving the chain: residuals, the hint, and the false-match bound."""
    chosen = matching.selected
    if matching.reason:
        return Solution(None, None, float("nan"), matching.reason)
    rows, unit = matching.row[chosen], matching.unit_cam[chosen]
    weights = matching.verification_votes[chosen].astype(float)
    reference = catalogue.icrs[rows].astype(float)
    reference /= np.linalg.norm(reference, axis=1, keepdims=True)
    quaternion = quest(unit, reference, weights)
    cam_from_icrs = matrix_from_quaternion(quaternion)
    miss_rad = np.linalg.norm(reference @ cam_from_icrs.T - unit, axis=1)
    if np.max(miss_rad) > parameters.tolerance_rad:
        pixels = float(np.max(miss_rad)) / camera.pixel_rad
        return Solution(None, None, float("nan"), f"matched stars do not fit one attitude: one is {pixels:.1f} px off")
    off_hint = _off_hint(matching.mode, hint, cam_from_icrs, camera, parameters)
    probability = false_match_probability(matching, cam_from_icrs, camera, catalogue, parameters)
    if off_hint or probability > parameters.max_false_probability:
        reason = off_hint or (
            f"{len(chosen)} of {len(matching.row)} centroids verified could be accidental: "
            f"bound {probability:.1e}, allowed {parameters.max_false_probability:.0e}"
        )
        return Solution(None, None, probability, reason)
    sigma_rad = centroids.sigma_px[chosen] * camera.pixel_rad
    covariance = weighted_covariance_rad2(unit, weights, sigma_rad)
    residual_px = centroids.pixels[chosen] - camera.project(reference @ cam_from_icrs.T)
    matches = Matches(chosen.astype(np.int32), catalogue.hip[rows].astype(np.int32), weights, residual_px)
    return Solution(Attitude(quaternion, covariance), matches, probability, "")


def hint_error_rad(camera: Camera, parameters: CubestarParameters) -> float:
    """How far the boresight may be from the hint: what D_max leaves beyond the field's half diagonal (Erlank 2013 §4.3.4)."""
    return max(parameters.assisted_radius_rad - _field_of(camera)[0], HINT_ERROR_RAD)


@lru_cache(maxsize=16)
def _field_of(camera: Camera) -> tuple[float, float]:
    """Half diagonal, rad, and solid angle, sr, of the field; the same for every frame of a camera."""
    fov_h, fov_v = camera.fov_rad
    return camera.half_diagonal_rad, float(4 * np.arcsin(np.sin(fov_h / 2) * np.sin(fov_v / 2)))


def _off_hint(
    mode: Mode, hint: Hint | None, cam_from_icrs: Array, camera: Camera, parameters: CubestarParameters
) -> str:
    if mode is not Mode.ASSISTED or hint is None:
        return ""
    boresight = np.asarray(hint.boresight_icrs, float)
    off_rad = float(2 * np.arcsin(np.linalg.norm(boresight / np.linalg.norm(boresight) - cam_from_icrs[2]) / 2))
    limit_rad = hint_error_rad(camera, parameters)
    if off_rad <= limit_rad:
        return ""
    return f"boresight is {np.degrees(off_rad):.1f}° from the hint; {np.degrees(limit_rad):.1f}° allowed"


def false_match_probability(
    matching: Matching,
    cam_from_icrs: Array,
    camera: Camera,
    catalogue: OnboardCatalogue,
    parameters: CubestarParameters,
) -> float:
    """Upper bound on the expected number of accidental identifications with as many stars as this one.

    Every table entry met is two ways to place a pair of centroids on the sky; each other centroid then lies on some catalogue
    star by chance with probability p = density · π · tolerance². Bound: hypotheses x P(binomial(n − 2, p) ≥ k − 2). A hint
    divides the hypotheses by the share of boresights it allows; in tracking they are the pairs of centroids that lie within
    the radius of predicted stars and keep their distance.
    """
    n, k = len(matching.row), len(matching.selected)
    projected = camera.project(catalogue.icrs.astype(float) @ cam_from_icrs.T)
    in_view = max(1, int(np.count_nonzero(camera.contains(projected))))
    per_sr = in_view / _field_of(camera)[1]
    by_chance = min(1.0, float(per_sr * np.pi * parameters.tolerance_rad**2))
    if matching.mode is Mode.TRACKING:
        near = min(1.0, float(per_sr * np.pi * parameters.tracking_radius_rad**2))
        same_distance = min(1.0, 1.1 * parameters.tolerance_rad / parameters.tracking_radius_rad)
        hypotheses = n * (n - 1) / 2 * near**2 * same_distance
    else:
        hypotheses = 2.0 * matching.hits
        if matching.mode is Mode.ASSISTED:
            hypotheses *= (1 - np.cos(hint_error_rad(camera, parameters))) / (
                1 - np.cos(parameters.assisted_radius_rad)
            )
    others = 1.0 if k <= 2 else float(bdtrc(k - 3, n - 2, by_chance))
    return float(min(1.0, hypotheses * others))


def solve(
    pixels: Pixels,
    camera: Camera,
    catalogue: OnboardCatalogue,
    parameters: CubestarParameters,
    *,
    mode: Mode = Mode.LOST_IN_SPACE,
    hint: Hint | None = None,
    clock: Callable[[], float] | None = None,
    trace: Trace | None = None,
) -> SolveResult:
    """One frame from pixels to attitude: find_centroids, match_stars, calculate_attitude."""
    if pixels.shape != (camera.rows, camera.columns):
        raise BadInput(
            "frame does not fit the camera",
            expected=f"{camera.rows} rows x {camera.columns} columns",
            got=" x ".join(map(str, pixels.shape)),
        )
    kept = trace if trace is not None else Trace(clock)
    with kept.stage("detect"):
        detection = find_centroids(pixels, parameters)
    kept.keep("detection", detection)
    result = solve_centroids(
        detection.centroids, camera, catalogue, parameters, mode=mode, hint=hint, clock=clock, trace=kept
    )
    return replace(result, regions=detection.regions, notes=detection.notes + result.notes)


def solve_centroids(
    centroids: Centroids,
    camera: Camera,
    catalogue: OnboardCatalogue,
    parameters: CubestarParameters,
    *,
    mode: Mode = Mode.LOST_IN_SPACE,
    hint: Hint | None = None,
    clock: Callable[[], float] | None = None,
    trace: Trace | None = None,
) -> SolveResult:
    """As :func:`solve` for centroids that are already known, brightest first; no regions."""
    kept = trace if trace is not None else Trace(clock)
    with kept.stage("match"):
        matching = match_stars(centroids, camera, catalogue, parameters, mode, hint)
    kept.keep("matching", matching)
    with kept.stage("attitude"):
        solution = calculate_attitude(matching, centroids, camera, catalogue, parameters, hint)
    over = len(centroids) - parameters.max_centroids
    return SolveResult(
        NAME,
        Outcome.SOLVED if solution.attitude is not None else Outcome.NONE,
        solution.reason,
        camera,
        (),
        centroids,
        solution.matches,
        solution.attitude,
        solution.false_match_probability,
        dict(kept.timing_s),
        (f"{over} faintest centroids not used: at most {parameters.max_centroids}",) if over > 0 else (),
    )
