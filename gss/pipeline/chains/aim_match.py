"""Star identification of the AIM smart camera: verification of expected stars, or blind search (Moniteq 1983 §6.1)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.results import Centroids
from gss.domain.rotation import matrix_from_quaternion, rotation_angle_rad
from gss.pipeline.attitude import svd
from gss.pipeline.chains.aim_parameters import AimParameters, detectable_mag
from gss.pipeline.chains.modes import AttitudePrior, Mode, check_hint
from gss.pipeline.identify.neighbour_pattern import (
    PairHypotheses,
    PatternSpots,
    PatternStars,
    magnitude_fits,
    pair_attitudes,
    pair_hypotheses,
    pattern_stars,
    supporters,
)
from gss.pipeline.identify.triplet_vote import agreement_of_candidates, consistent_set
from gss.pipeline.track.constant_rate import extrapolate
from gss.pipeline.track.link_walk import walk
from gss.pipeline.track.predictional import Fit, predictional_fit
from gss.pipeline.track.search_and_track import VERIFIED_ENOUGH, raises_guidance_error
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.neighbours import NeighbourLinks, link_distances, neighbour_links
from gss.skytables.pairs import DistanceTable

Index = NDArray[np.intp]
FURTHEST_STEP_RAD = float(np.radians(3.0))
FITTED = 12


@dataclass(frozen=True)
class AimCatalogue:
    """A bank prepared for AIM: star list, the same stars in full precision with their search structures, links to
    neighbours and their lengths, and the magnitude to which the list is complete."""

    stars: OnboardCatalogue
    pattern: PatternStars
    links: NeighbourLinks
    lengths: DistanceTable
    limit_mag: float

    @property
    def icrs(self) -> Array:
        """Return the (n, 3) unit vectors."""
        return self.pattern.icrs

    def __len__(self) -> int:
        return len(self.stars)


def prepare(catalogue: OnboardCatalogue, profile: CameraProfile) -> AimCatalogue:
    """Prepare the bank. Neighbour links are computed if the bank does not contain them."""
    icrs = catalogue.icrs.astype(float)
    icrs /= np.maximum(np.linalg.norm(icrs, axis=1, keepdims=True), 1e-300)
    links = neighbour_links(icrs) if catalogue.tables.links is None else catalogue.tables.links
    finite_mag = catalogue.v_mag[np.isfinite(catalogue.v_mag)]
    limit = min(float(finite_mag.max()), detectable_mag(profile)) if len(finite_mag) else profile.sensor.faint_limit_mag
    pattern = pattern_stars(icrs, catalogue.v_mag.astype(float))
    return AimCatalogue(catalogue, pattern, links, link_distances(links, icrs), limit)


@dataclass(frozen=True)
class PredictedStars:
    """Stars expected in the field: rows in the star list, directions (n, 3) in the predicted camera frame, and
    ``checks``, the number of examined stars."""

    rows: Index
    predicted_cam: Array
    cam_from_icrs: Array
    checks: int


def expected_stars(
    catalogue: AimCatalogue, camera: Camera, hint: AttitudePrior, parameters: AimParameters
) -> PredictedStars:
    """Find the stars of the field predicted from the last attitudes, along the links from the previous field (step 2b)."""
    if hint.quaternion is None:
        raise BadInput("tracking needs a hint", expected="a full attitude", got="a boresight only")
    last = matrix_from_quaternion(hint.quaternion)
    ahead = last
    if hint.earlier:
        step = extrapolate(hint.quaternion, hint.earlier[0], hint.steps)
        ahead = step if rotation_angle_rad(step, last) <= FURTHEST_STEP_RAD else last
    radius = camera.half_diagonal_rad
    before = np.flatnonzero(catalogue.icrs @ last[2] >= np.cos(radius))
    visited = walk(catalogue.links, catalogue.icrs, before, ahead[2], radius + parameters.capture_rad)
    return PredictedStars(visited.rows, catalogue.icrs[visited.rows] @ ahead.T, ahead, visited.checks)


@dataclass(frozen=True)
class AimMatching:
    """Result of MATCH_STARS. ``mode``: search that gave the result. Per centroid, (n,): ``row`` or −1. ``selected``: centroids for
    the attitude, empty with a ``reason``; ``cam_from_icrs``: fitted attitude. ``guidance_error``: flag of Fig.
    6.1. ``hypotheses``: number of linked pairs tried; ``checks``: number of stars and links examined."""

    mode: Mode
    unit_cam: Array
    row: Index
    selected: Index
    cam_from_icrs: Array | None
    guidance_error: bool
    hypotheses: int
    checks: int
    reason: str

    @property
    def weight(self) -> Array:
        """Return (n,) weights, 1 for every verified star and 0 for others."""
        return (self.row >= 0).astype(float)

    @property
    def operations(self) -> int:
        """Return the number of examined stars and links plus the number of comparisons between tried pairs and
        spots."""
        return self.checks + self.hypotheses * len(self.row)

    @property
    def confidence(self) -> float:
        """Return the share of identified centroids."""
        return len(self.selected) / len(self.row) if len(self.row) else 0.0


def match_stars(
    centroids: Centroids,
    camera: Camera,
    catalogue: AimCatalogue,
    parameters: AimParameters,
    mode: Mode = Mode.LOST_IN_SPACE,
    hint: AttitudePrior | None = None,
) -> AimMatching:
    """Identify centroids. In tracking, expected stars are verified; a blind search is used in other modes and after a
    guidance error."""
    check_hint(mode, hint)
    unit = camera.unproject(centroids.pixels)
    spots = _spots(centroids, unit, parameters)
    guidance_error, checks = False, 0
    if mode is Mode.TRACKING and hint is not None:
        expected = expected_stars(catalogue, camera, hint, parameters)
        checks = expected.checks
        fit = _verify(spots, expected, camera, catalogue, parameters)
        verified = 0 if fit is None else len(fit.row)
        guidance_error = raises_guidance_error(verified, len(spots) - verified)
        if not guidance_error:
            return _matching(mode, unit, spots, fit, False, 0, checks, parameters)
        mode = Mode.ASSISTED
    fit, pairs = _blind(spots, camera, catalogue, parameters, mode, hint)
    matching = _matching(mode, unit, spots, fit, guidance_error, len(pairs), checks + pairs.checks, parameters)
    if matching.reason and pairs.left_out:
        return replace(
            matching, reason=f"{matching.reason}; {len(pairs)} pairs of stars tried, {pairs.left_out} left out"
        )
    return matching


def _spots(centroids: Centroids, unit: Array, parameters: AimParameters) -> PatternSpots:
    # A centroid outside the domain of the distortion has no direction. It remains in the arrays but is not used.
    good = np.flatnonzero(np.isfinite(unit).all(axis=1))
    flux = np.maximum(centroids.flux_dn[good], 1e-9) / (parameters.dn_at_mag_0 * parameters.light_share)
    saturated = centroids.peak_dn[good] >= 0.97 * parameters.saturation_dn
    return PatternSpots(good, unit[good], -2.5 * np.log10(flux), saturated)


def _verify(
    spots: PatternSpots, expected: PredictedStars, camera: Camera, catalogue: AimCatalogue, parameters: AimParameters
) -> Fit | None:
    """Verify the stars detected at their predicted positions with the expected brightness and separations (step 2e)."""
    chord = np.linalg.norm(spots.unit[:, None] - expected.predicted_cam[None], axis=2)
    near = chord <= 2 * np.sin(parameters.capture_rad / 2)
    star_mag = catalogue.pattern.v_mag[expected.rows]
    near &= magnitude_fits(spots.mag[:, None], spots.saturated[:, None], star_mag[None], parameters.magnitude_error)
    spot, star = np.nonzero(near)
    candidate = expected.rows[star]
    agree = agreement_of_candidates(spots.unit, spot, catalogue.icrs, candidate, 2 * parameters.tolerance_rad)
    chosen = consistent_set(agree, agree.sum(axis=1))
    if len(chosen) < VERIFIED_ENOUGH:
        return None
    attitude = svd(spots.unit[spot[chosen]], catalogue.icrs[candidate[chosen]])
    return _fit(spots, attitude, camera, catalogue, parameters)


def _fit(
    spots: PatternSpots, attitude: Array, camera: Camera, catalogue: AimCatalogue, parameters: AimParameters
) -> Fit | None:
    """Match the image predicted at an attitude, correct the attitude differentially, and drop stars whose spots have
    another brightness."""
    rows = np.flatnonzero(catalogue.icrs @ attitude[2] >= np.cos(camera.half_diagonal_rad + parameters.capture_rad))
    radii = (2 * parameters.tolerance_rad, parameters.tolerance_rad)
    fit = predictional_fit(spots.unit, catalogue.icrs, rows, attitude, radii, camera.half_diagonal_rad)
    if fit is None:
        return None
    bright = magnitude_fits(
        spots.mag[fit.measured],
        spots.saturated[fit.measured],
        catalogue.pattern.v_mag[fit.row],
        parameters.magnitude_error,
    )
    return Fit(fit.cam_from_icrs, fit.measured[bright], fit.row[bright], fit.compared)


def _blind(
    spots: PatternSpots,
    camera: Camera,
    catalogue: AimCatalogue,
    parameters: AimParameters,
    mode: Mode,
    hint: AttitudePrior | None,
) -> tuple[Fit | None, PairHypotheses]:
    """Return the best pattern of linked stars and the hypotheses that were tried (step 3)."""
    allowed = np.ones(len(catalogue), bool)
    if mode is not Mode.LOST_IN_SPACE and hint is not None:
        boresight = np.asarray(hint.boresight_icrs, float)
        boresight = boresight / np.linalg.norm(boresight)
        allowed = catalogue.icrs @ boresight >= np.cos(parameters.assisted_radius_rad)
    pairs = pair_hypotheses(
        spots,
        catalogue.lengths,
        catalogue.pattern.v_mag,
        allowed,
        2 * parameters.tolerance_rad,
        parameters.magnitude_error,
        parameters.max_hypotheses,
    )
    if not len(pairs):
        return None, pairs
    attitudes = pair_attitudes(spots.unit, catalogue.icrs, pairs)
    tolerance_rad = 2 * parameters.tolerance_rad
    count = supporters(spots, pairs, attitudes, catalogue.pattern, tolerance_rad, parameters.magnitude_error)
    best: Fit | None = None
    for k in np.argsort(-count, kind="stable")[:FITTED].tolist():
        if best is not None and count[k] <= len(best.row):
            break  # supporters are counted within a larger radius than the matches of a fit
        fit = _fit(spots, attitudes[k], camera, catalogue, parameters)
        if fit is not None and (best is None or len(fit.row) > len(best.row)):
            best = fit
    return best, pairs


def _matching(
    mode: Mode,
    unit: Array,
    spots: PatternSpots,
    fit: Fit | None,
    guidance_error: bool,
    hypotheses: int,
    checks: int,
    parameters: AimParameters,
) -> AimMatching:
    row, selected = np.full(len(unit), -1, np.intp), np.empty(0, np.intp)
    if fit is not None:
        selected = spots.index[fit.measured]
        row[selected] = fit.row
        checks += fit.compared
    reason = _too_few(len(unit), len(selected), parameters.min_verified(mode), mode, guidance_error)
    attitude = None if fit is None else fit.cam_from_icrs
    chosen = selected if not reason else selected[:0]
    return AimMatching(mode, unit, row, chosen, attitude, guidance_error, hypotheses, checks, reason)


def _too_few(centroids: int, verified: int, needed: int, mode: Mode, guidance_error: bool) -> str:
    if centroids == 0:
        return "no star found in the frame"
    if verified >= needed:
        return ""
    after = " after a guidance error" if guidance_error else ""
    stars = "centroid" if centroids == 1 else "centroids"
    narrow = "; a field this narrow seldom shows enough without a hint" if mode is Mode.LOST_IN_SPACE else ""
    return f"{verified} of {centroids} {stars} verified; {needed} needed in {mode.value.replace('_', ' ')} mode{after}{narrow}"
