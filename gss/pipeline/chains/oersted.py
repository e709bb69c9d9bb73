"""The chain of the Oersted star imager (Liebe 1992): sub-pixel centroids of the brightest stars, triplets, predicted
image.

The initial estimate identifies stars by the distances to their two nearest neighbours and the angle between them; the
predictional estimate fits the predicted image to the measured one. ``oersted_parameters.SOURCES`` documents, for each
parameter, the choices that the document leaves open and the tests added against false attitudes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gss.domain.angles import Array, cross
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.results import Attitude, Centroids
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix
from gss.pipeline.attitude import weighted_covariance_rad2
from gss.pipeline.centroid import brightest_first
from gss.pipeline.chains import proof
from gss.pipeline.chains.modes import AttitudePrior, Mode
from gss.pipeline.chains.oersted_match import OerstedCatalogue, OerstedMatching, match_stars, prepare
from gss.pipeline.chains.oersted_parameters import NAME, OerstedParameters, default_parameters
from gss.pipeline.chains.onboard import Commanded, Detection, OnboardSolution, Work, with_commanded
from gss.pipeline.hyperaccuracy import brightest_pixels, hyperaccurate_centroids, inside_frame
from gss.pipeline.identify.accidental import accidental_bound, chance_within, tracking_hypotheses
from gss.pipeline.identify.soundness import errors_objection, separate_stars
from gss.pipeline.regions import Pixels, SearchLimits, grid_median_dn, region_records, search
from gss.pipeline.track.constant_rate import average_estimates
from gss.pipeline.track.differential import differential_attitude
from gss.skytables.bank import OnboardCatalogue

# Liebe 1992 Table 4: 2 s for an initial, ½ s for a predictional estimate on a 386 at 33 MHz. The times of the steps are
# estimated.
DETECT_MS, REGION_MS = 250.0, 0.5
INITIAL_MS, CANDIDATE_MS, PREDICTIONAL_MS, ATTITUDE_MS, STAR_MS = 700.0, 2.5, 120.0, 80.0, 1.0
MAX_REGIONS = 1000
COMPANION = 3.0


def find_centroids(pixels: Pixels, parameters: OerstedParameters, limit_mag: float) -> Detection:
    """Find the stars brighter than the limit of the triplet table and compute the centroid of each in its window."""
    p = parameters
    black_dn = grid_median_dn(pixels)
    limits = SearchLimits(p.min_area_px, p.max_area_px, p.max_invalid, MAX_REGIONS, True)
    regions = search(pixels, black_dn + p.threshold_dn, limits, 1)
    stars = regions.blobs.take(regions.accepted)
    complete = inside_frame(*brightest_pixels(pixels, stars), pixels.shape, p.window_px // 2)
    measured = hyperaccurate_centroids(
        pixels, stars.take(np.flatnonzero(complete)), p.window_px, p.noise, p.saturation_dn
    )
    bright = measured.flux_dn >= p.dn_at_mag_0 * 10 ** (-0.4 * limit_mag)
    rejected = list(regions.rejected)
    for k in regions.accepted[~complete].tolist():
        rejected[k] = "window leaves the frame"
    for k in regions.accepted[complete][~bright].tolist():
        rejected[k] = f"fainter than V {limit_mag:.1f}"
    centroids = measured.take(bright)
    centroids = centroids.take(brightest_first(centroids)[: p.max_centroids])
    return Detection(
        region_records(pixels, replace(regions, rejected=tuple(rejected)), black_dn, p.max_small_regions),
        centroids,
        regions.invalid,
        black_dn,
        (regions.stopped,) if regions.stopped else (),
    )


def calculate_attitude(
    matching: OerstedMatching,
    centroids: Centroids,
    camera: Camera,
    catalogue: OerstedCatalogue,
    parameters: OerstedParameters,
    hint: AttitudePrior | None = None,
) -> OnboardSolution:
    """Compute the least-squares attitude of the selected stars by differential correction, and reject false attitudes by
    residuals, hint and false-match bound."""
    chosen = matching.selected
    if matching.reason or matching.cam_from_icrs is None:
        return proof.rejected(matching.reason)
    rows, unit = matching.row[chosen], matching.unit_cam[chosen]
    reference = catalogue.icrs[rows]
    cam_from_icrs = differential_attitude(unit, reference, matching.cam_from_icrs)
    if cam_from_icrs is None:
        return proof.rejected(f"{len(chosen)} stars in one direction do not determine the attitude")
    sigma_rad = centroids.sigma_px[chosen] * camera.pixel_rad
    probability = false_match_probability(matching, cam_from_icrs, camera, catalogue, parameters)
    reason = _objection(matching, cam_from_icrs, centroids, camera, catalogue, parameters, hint, probability)
    reason = reason or _another_focal_length(matching, centroids, camera, catalogue, parameters)
    weights, residual_px = np.ones(len(chosen)), centroids.pixels[chosen] - camera.project(reference @ cam_from_icrs.T)
    covariance = weighted_covariance_rad2(unit, weights, sigma_rad)
    reason = reason or proof.undetermined(covariance, residual_px, centroids.sigma_px[chosen], camera)
    if reason and parameters.proves:
        return proof.rejected(reason, probability)
    quaternion = _averaged(quaternion_from_matrix(cam_from_icrs), matching.mode, hint, parameters)
    final = matrix_from_quaternion(quaternion)
    seen_px, attitude = camera.project(reference @ final.T), Attitude(quaternion, covariance)
    return proof.solved(attitude, probability, centroids, chosen, catalogue.stars.hip[rows], weights, seen_px)


def _averaged(quaternion: Array, mode: Mode, hint: AttitudePrior | None, parameters: OerstedParameters) -> Array:
    """Return the latest estimate, smoothed over the last ``averaged`` estimates; unchanged if averaging is off."""
    if mode is not Mode.TRACKING or hint is None or hint.quaternion is None or parameters.averaged == 1:
        return quaternion
    estimates = [quaternion, hint.quaternion, *hint.earlier][: parameters.averaged]
    return average_estimates(estimates, ages_s=(0.0, *hint.ages_s)[: len(estimates)])


def _objection(
    matching: OerstedMatching,
    cam_from_icrs: Array,
    centroids: Centroids,
    camera: Camera,
    catalogue: OerstedCatalogue,
    parameters: OerstedParameters,
    hint: AttitudePrior | None,
    probability: float,
) -> str:
    """Return the reason to reject this attitude, or ""."""
    chosen = matching.selected
    sigma_rad = centroids.sigma_px[chosen] * camera.pixel_rad
    reference = catalogue.icrs[matching.row[chosen]]
    miss_rad = np.linalg.norm(reference @ cam_from_icrs.T - matching.unit_cam[chosen], axis=1)
    unit, tolerance_rad = matching.unit_cam[chosen], parameters.uncertainty_rad
    near = hint if matching.mode is Mode.ASSISTED else None
    return (
        proof.misfit(miss_rad, 1.05 * tolerance_rad, camera.pixel_rad)
        or errors_objection(miss_rad, sigma_rad, tolerance_rad, camera.pixel_rad)
        # With two stars, a mirrored frame cannot be detected. In tracking, two stars are tested only with the bound.
        or (proof.mirrored(unit, reference, tolerance_rad) if len(chosen) > 2 else "")
        or (proof.off_hint(near, cam_from_icrs, _hint_error_rad(camera, parameters)) if near else "")
        or proof.accidental(len(chosen), len(matching.row), probability, parameters.max_false_probability)
        or proof.displaced(unit, centroids.sigma_px[chosen], reference, camera, cam_from_icrs)
        or proof.few_identified(
            len(chosen), len(matching.row), probability, catalogue.icrs[catalogue.detectable], cam_from_icrs, camera
        )
    )


def _another_focal_length(
    matching: OerstedMatching,
    centroids: Centroids,
    camera: Camera,
    catalogue: OerstedCatalogue,
    parameters: OerstedParameters,
) -> str:
    chosen, bank = matching.selected, catalogue.icrs[catalogue.detectable]
    reference, radius_px = catalogue.icrs[matching.row[chosen]], parameters.uncertainty_rad / camera.pixel_rad
    return proof.another_focal_length(centroids.pixels, matching.unit_cam, chosen, reference, bank, camera, radius_px)


def _hint_error_rad(camera: Camera, parameters: OerstedParameters) -> float:
    return proof.hint_error_rad(camera, parameters.assisted_radius_rad, parameters.uncertainty_rad)


def false_match_probability(
    matching: OerstedMatching,
    cam_from_icrs: Array,
    camera: Camera,
    catalogue: OerstedCatalogue,
    parameters: OerstedParameters,
) -> float:
    """Return a bound on the expected number of accidental identifications with as many stars as this one.

    The stars of a triplet were selected to fit, so a matching triplet does not show that the match is correct.
    Therefore every attitude that maps a pair of centroids to a pair of stars is counted as a hypothesis, even if it
    does not result from the triplet table.
    """
    tolerance = parameters.uncertainty_rad
    # Companions within each other's tolerance are not independent evidence and count as one star.
    n, k = len(matching.row), separate_stars(matching.unit_cam[matching.selected], COMPANION * tolerance)
    catalogue_icrs = catalogue.icrs[catalogue.detectable]
    per_sr = proof.stars_per_sr(catalogue_icrs, cam_from_icrs, camera)
    if matching.mode is Mode.TRACKING:
        hypotheses = tracking_hypotheses(n, per_sr, tolerance, parameters.capture_rad)
    else:
        hypotheses = pair_placements(matching.unit_cam, len(catalogue_icrs), 2 * tolerance)
        if matching.mode is Mode.ASSISTED:
            hypotheses *= (1 - np.cos(_hint_error_rad(camera, parameters))) / 2
    return accidental_bound(hypotheses, k, n, chance_within(per_sr, tolerance))


def pair_placements(unit_cam: Array, stars: int, tolerance_rad: float) -> float:
    """Return the expected number of mappings of any two of (n, 3) directions to any two of ``stars`` stars over the whole sky."""
    good = unit_cam[np.isfinite(unit_cam).all(axis=1)]
    i, j = np.triu_indices(len(good), 1)
    sine = np.linalg.norm(cross(good[i], good[j]), axis=1)
    return float(np.sum(np.maximum(sine, tolerance_rad)) * stars * (stars - 1) * tolerance_rad)


class OerstedChain:
    """See :class:`gss.pipeline.chains.onboard.OnboardChain`."""

    name = NAME
    oldest_attitude_s = float("inf")

    def parameters(
        self, profile: CameraProfile, exposure_s: float | None, commanded: Commanded, mode: Mode
    ) -> OerstedParameters:
        return with_commanded(default_parameters(profile, exposure_s), profile.camera, commanded, mode)

    def prepare(self, catalogue: OnboardCatalogue, profile: CameraProfile) -> OerstedCatalogue:
        return prepare(catalogue, profile)

    def find_centroids(self, pixels: Pixels, work: Work) -> Detection:
        return find_centroids(pixels, work.parameters, work.catalogue.triplets.limit_mag)

    def match_stars(self, centroids: Centroids, work: Work) -> OerstedMatching:
        return match_stars(centroids, work.camera, work.catalogue, work.parameters, work.mode, work.hint)

    def calculate_attitude(self, matching: OerstedMatching, centroids: Centroids, work: Work) -> OnboardSolution:
        return calculate_attitude(matching, centroids, work.camera, work.catalogue, work.parameters, work.hint)

    def next_mode(self, mode: Mode, solved: bool) -> Mode:
        """Return the next mode: the predictional estimate while it succeeds, else the initial estimate (Liebe 1992,
        "Algorithms")."""
        return Mode.TRACKING if solved else Mode.LOST_IN_SPACE

    def detect_ms(self, pixels: int, detection: Detection) -> float:
        return DETECT_MS * pixels / (604 * 576) + REGION_MS * (len(detection.regions) + detection.invalid)

    def match_ms(self, matching: OerstedMatching) -> float:
        if matching.mode is Mode.TRACKING:
            return PREDICTIONAL_MS
        return INITIAL_MS + CANDIDATE_MS * matching.candidates

    def attitude_ms(self, matching: OerstedMatching) -> float:
        return ATTITUDE_MS + STAR_MS * len(matching.selected)
