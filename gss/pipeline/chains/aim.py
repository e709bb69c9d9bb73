"""The chain of the AIM smart camera (Moniteq 1983): coarse mask, mean locator, linked neighbours, differential
attitude.

The chain normally has an approximate attitude and verifies the stars that are expected at this attitude. According to
the document's statistics (§2.1), about half of the fields of 3.45° have too few stars for a search over the whole sky.
The reason text of such a frame states this. ``aim_parameters.SOURCES`` documents the choices that the document leaves
open and the tests added against false attitudes.
"""

from __future__ import annotations

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.failure_cause import MIRRORED
from gss.domain.results import Attitude, Centroids
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix
from gss.pipeline.attitude import weighted_covariance_rad2
from gss.pipeline.chains import proof
from gss.pipeline.chains.aim_detect import find_centroids
from gss.pipeline.chains.aim_match import AimCatalogue, AimMatching, match_stars, prepare
from gss.pipeline.chains.aim_parameters import NAME, AimParameters, default_parameters
from gss.pipeline.chains.modes import AttitudePrior, Mode, next_mode
from gss.pipeline.chains.onboard import Commanded, Detection, OnboardSolution, Work, with_commanded
from gss.pipeline.identify.accidental import accidental_bound, chance_within, tracking_hypotheses
from gss.pipeline.identify.soundness import DOUBTFUL_PROBABILITY, errors_objection, separate_stars
from gss.pipeline.regions import Pixels
from gss.pipeline.track.differential import differential_attitude
from gss.skytables.bank import OnboardCatalogue

# Moniteq 1983 §3.12, T7.1: the converter takes 25 µs per pixel. The document does not state execution times, so the
# times per operation are estimates.
PIXEL_MS, REGION_MS, OPERATION_MS, ATTITUDE_MS, STAR_MS = 0.025, 1.0, 0.05, 20.0, 5.0
DENSITY_RADIUS_RAD = float(np.radians(5.0))
LOOSE, COMPANION = 2.0, 6.0
PAIR, TURN_SIGMAS = 2, 3.0


def calculate_attitude(
    matching: AimMatching,
    centroids: Centroids,
    camera: Camera,
    catalogue: AimCatalogue,
    parameters: AimParameters,
    hint: AttitudePrior | None = None,
) -> OnboardSolution:
    """Compute the attitude by iterated differential correction (Moniteq 1983 §6.2). Reject false attitudes by
    residuals, hint and false-match bound. A single camera determines the angle about its axis poorly, as the covariance
    shows; see :mod:`gss.pipeline.track.cameras_together` for two cameras."""
    chosen = matching.selected
    if matching.reason or matching.cam_from_icrs is None:
        return proof.rejected(matching.reason)
    rows, unit = matching.row[chosen], matching.unit_cam[chosen]
    reference = catalogue.icrs[rows]
    sigma_rad = centroids.sigma_px[chosen] * camera.pixel_rad
    attitude = differential_attitude(unit, reference, matching.cam_from_icrs)
    if attitude is None:
        return proof.rejected(f"{len(chosen)} stars in one direction do not determine the attitude")
    probability = false_match_probability(matching, attitude, camera, catalogue, parameters)
    weights, seen_px = np.ones(len(chosen)), camera.project(reference @ attitude.T)
    covariance = weighted_covariance_rad2(unit, weights, sigma_rad)
    reason = _objection(matching, attitude, centroids, camera, catalogue, parameters, hint, probability)
    residual_px = centroids.pixels[chosen] - seen_px
    reason = reason or proof.undetermined(covariance, residual_px, centroids.sigma_px[chosen], camera)
    if reason and parameters.proves:
        return proof.rejected(reason, probability)
    result = Attitude(quaternion_from_matrix(attitude), covariance)
    return proof.solved(result, probability, centroids, chosen, catalogue.stars.hip[rows], weights, seen_px)


def _objection(
    matching: AimMatching,
    attitude: Array,
    centroids: Centroids,
    camera: Camera,
    catalogue: AimCatalogue,
    parameters: AimParameters,
    hint: AttitudePrior | None,
    probability: float,
) -> str:
    """Return the reason to reject this attitude, or ""."""
    chosen = matching.selected
    sigma_rad = centroids.sigma_px[chosen] * camera.pixel_rad
    reference = catalogue.icrs[matching.row[chosen]]
    miss_rad = np.linalg.norm(reference @ attitude.T - matching.unit_cam[chosen], axis=1)
    near = None if matching.mode is Mode.LOST_IN_SPACE else hint
    limit_rad = proof.hint_error_rad(camera, parameters.assisted_radius_rad, parameters.capture_rad)
    return (
        proof.misfit(miss_rad, 1.05 * parameters.tolerance_rad, camera.pixel_rad)
        or errors_objection(miss_rad, sigma_rad, parameters.tolerance_rad, camera.pixel_rad)
        or _may_be_mirrored(matching, attitude, reference, sigma_rad, parameters, hint)
        or (proof.off_hint(near, attitude, limit_rad) if near else "")
        or proof.accidental(len(chosen), len(matching.row), probability, parameters.max_false_probability)
        or proof.displaced(matching.unit_cam[chosen], centroids.sigma_px[chosen], reference, camera, attitude)
        or proof.few_identified(len(chosen), len(matching.row), probability, catalogue.icrs, attitude, camera)
        or _matches_mirrored(matching, centroids, camera, catalogue, parameters, hint, probability)
    )


def _may_be_mirrored(
    matching: AimMatching,
    attitude: Array,
    reference: Array,
    sigma_rad: Array,
    parameters: AimParameters,
    hint: AttitudePrior | None,
) -> str:
    """Return why the frame could be mirrored, or "". With two stars, a mirrored frame cannot be detected. In tracking,
    a mirrored pair rarely has the orientation of the expected pair. Therefore an attitude from two stars is rejected if
    it is rotated far from the hint."""
    unit = matching.unit_cam[matching.selected]
    if len(unit) > PAIR or matching.mode is not Mode.TRACKING or hint is None or hint.quaternion is None:
        return proof.mirrored(unit, reference, parameters.tolerance_rad)
    turn = attitude @ matrix_from_quaternion(hint.quaternion).T
    turn_rad = float(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
    apart_rad = float(np.linalg.norm(unit[1] - unit[0]))
    limit_rad = parameters.capture_rad + TURN_SIGMAS * float(np.linalg.norm(sigma_rad)) / max(apart_rad, 1e-9)
    if turn_rad <= limit_rad:
        return ""
    return f"two stars would turn the attitude by {np.degrees(turn_rad):.2f}°; {np.degrees(limit_rad):.2f}° believed"


def _matches_mirrored(
    matching: AimMatching,
    centroids: Centroids,
    camera: Camera,
    catalogue: AimCatalogue,
    parameters: AimParameters,
    hint: AttitudePrior | None,
    probability: float,
) -> str:
    """Return the reason if the mirrored frame matches more stars, or as many if there are three or more, or "". A few stars of
    a mirrored frame match near a known attitude more often than the bound states, so the frame is tested unless the
    bound is very small. Two stars match mirrored as well, only with another rotation."""
    if probability <= DOUBTFUL_PROBABILITY:
        return ""
    mode = matching.mode if hint is None or hint.quaternion is None else Mode.TRACKING
    mirrored = match_stars(centroids.mirrored(camera.columns), camera, catalogue, parameters, mode, hint)
    found, selected = len(mirrored.selected), len(matching.selected)
    if found > selected:
        return MIRRORED
    return f"{selected} stars match, and as many in the mirrored frame" if found == selected > PAIR else ""


def false_match_probability(
    matching: AimMatching, attitude: Array, camera: Camera, catalogue: AimCatalogue, parameters: AimParameters
) -> float:
    """Return a bound on the expected number of accidental identifications with as many stars as this one.

    Every tried pair of linked stars is a hypothesis. A star is matched within twice the tolerance, because a close pair
    determines the roll poorly. The star density is that of the sky around the field; Moniteq 1983 §2.1 uses the mean
    density of the sky.
    """
    # Companions within each other's tolerance are not independent evidence and count as one star.
    n, k = len(matching.row), separate_stars(matching.unit_cam[matching.selected], COMPANION * parameters.tolerance_rad)
    near = int(np.count_nonzero(catalogue.icrs @ attitude[2] >= np.cos(DENSITY_RADIUS_RAD)))
    per_sr = max(near, k) / (2 * np.pi * (1 - np.cos(DENSITY_RADIUS_RAD)))
    chance = chance_within(per_sr, LOOSE * parameters.tolerance_rad)
    if matching.mode is Mode.TRACKING:
        return accidental_bound(
            tracking_hypotheses(n, per_sr, LOOSE * parameters.tolerance_rad, parameters.capture_rad), k, n, chance
        )
    return accidental_bound(float(max(matching.hypotheses, 1)), k, n, chance)


class AimChain:
    """See :class:`gss.pipeline.chains.onboard.OnboardChain`."""

    name = NAME
    oldest_attitude_s = float("inf")

    def parameters(
        self, profile: CameraProfile, exposure_s: float | None, commanded: Commanded, mode: Mode
    ) -> AimParameters:
        return with_commanded(default_parameters(profile, exposure_s), profile.camera, commanded, mode)

    def prepare(self, catalogue: OnboardCatalogue, profile: CameraProfile) -> AimCatalogue:
        return prepare(catalogue, profile)

    def find_centroids(self, pixels: Pixels, work: Work) -> Detection:
        return find_centroids(pixels, work.camera, work.catalogue, work.parameters, work.mode, work.hint)

    def match_stars(self, centroids: Centroids, work: Work) -> AimMatching:
        return match_stars(centroids, work.camera, work.catalogue, work.parameters, work.mode, work.hint)

    def calculate_attitude(self, matching: AimMatching, centroids: Centroids, work: Work) -> OnboardSolution:
        return calculate_attitude(matching, centroids, work.camera, work.catalogue, work.parameters, work.hint)

    def next_mode(self, mode: Mode, solved: bool) -> Mode:
        """Return the next mode: tracking after a solved frame, then a search of part of the sky, then of the whole sky
        (Fig. 6.1)."""
        return next_mode(mode, solved)

    def detect_ms(self, pixels: int, detection: Detection) -> float:
        return PIXEL_MS * pixels + REGION_MS * (len(detection.centroids) + detection.invalid)

    def match_ms(self, matching: AimMatching) -> float:
        return OPERATION_MS * matching.operations

    def attitude_ms(self, matching: AimMatching) -> float:
        return ATTITUDE_MS + STAR_MS * len(matching.selected)
