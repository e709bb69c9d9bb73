"""The chain of the Sunsat star sensor (Jacobs 1995 ch. 2–4): region growing, match groups, tracking in windows, TRIAD.

The chain has no state: the prior knowledge of the tracker is passed in the hint. ``sunsat_parameters.SOURCES``
documents, for each parameter, the choices that the document leaves open and the tests added against false attitudes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gss.domain.angles import Array, cross
from gss.domain.camera import Camera
from gss.domain.results import Attitude, Centroids
from gss.domain.rotation import quaternion_from_matrix
from gss.pipeline.attitude import triad
from gss.pipeline.chains import proof
from gss.pipeline.chains.modes import AttitudePrior, Mode
from gss.pipeline.chains.onboard import Detection, OnboardSolution
from gss.pipeline.chains.sunsat_bound import Census, census, confirmed, false_match_probability, in_view
from gss.pipeline.chains.sunsat_detect import brightest, find_stars, zero_rows_dn
from gss.pipeline.chains.sunsat_match import SunsatCatalogue, SunsatMatching, candidates
from gss.pipeline.chains.sunsat_parameters import SunsatParameters
from gss.pipeline.chains.sunsat_track import off_prediction_px
from gss.pipeline.regions import Pixels

FOCAL_TOLERANCES = 2.0


def find_in_frame(pixels: Pixels, parameters: SunsatParameters, dark: Pixels | None = None) -> Detection:
    """Find the stars in a whole frame (Jacobs 1995 §2.2). ``dark``: (rows, n) pixels of the dark columns."""
    zero_dn, note = zero_rows_dn(pixels, dark, parameters)
    detected = find_stars(pixels.astype(np.float32) - zero_dn.astype(np.float32)[:, None], parameters)
    centroids = detected.centroids.take(brightest(detected.centroids))
    notes = (note, detected.stopped) if detected.stopped else (note,)
    return Detection(detected.regions, centroids, detected.invalid, float(np.median(zero_dn)), notes)


def match_stars(
    centroids: Centroids,
    camera: Camera,
    catalogue: SunsatCatalogue,
    parameters: SunsatParameters,
    mode: Mode,
    hint: AttitudePrior | None,
) -> SunsatMatching:
    """Identify stars, lost in space or assisted (Jacobs 1995 ch. 3).

    The document uses the brightest eight stars and the largest group. With acceptance by bound, a group is rejected if
    its attitude does not meet the bound. Then other groups of the same size are tried, followed by the next eight
    stars, of which four are new.
    """
    p = parameters
    first_results: list[SunsatMatching] = []
    rounds = p.max_rounds if p.acceptance == "bound" else 1
    for first in range(0, rounds * p.max_observed // 2, max(1, p.max_observed // 2)):
        if first and len(centroids) < first + p.min_group:
            break
        before = (first_results[-1].hypotheses, first_results[-1].operations) if first_results else (0.0, 0)
        results = [
            replace(m, hypotheses=m.hypotheses + before[0], operations=m.operations + before[1])
            for m in candidates(centroids, camera, catalogue, p, mode, hint, first)
        ]
        if p.acceptance == "document":
            return results[0]
        accepted = [
            m for m in results if calculate_attitude(m, centroids, camera, catalogue, p, hint).attitude is not None
        ]
        if accepted and _same_attitude(accepted):
            return accepted[0]
        first_results.append(results[0])
    return replace(first_results[0], operations=first_results[-1].operations)


def _same_attitude(matchings: list[SunsatMatching]) -> bool:
    """True if the matchings have two identified stars in common."""
    identified = [set(zip(m.selected.tolist(), m.row[m.selected].tolist(), strict=True)) for m in matchings]
    return all(len(identified[0] & other) > 1 for other in identified[1:])


def calculate_attitude(
    matching: SunsatMatching,
    centroids: Centroids,
    camera: Camera,
    catalogue: SunsatCatalogue,
    parameters: SunsatParameters,
    hint: AttitudePrior | None = None,
) -> OnboardSolution:
    """Compute the attitude by TRIAD from the two matched stars that are farthest apart (§4.1.6.1). An attitude is
    accepted only if every matched star fits, the boresight agrees with the hint, and an accidental match is improbable.
    The matches contain the group and the stars that only confirm it. The pair used by TRIAD has weight one, all other
    stars have weight zero.
    """
    p, chosen = parameters, matching.selected
    if matching.reason:
        return proof.rejected(matching.reason)
    rows = matching.row[chosen]
    cam_from_icrs, covariance = _triad(matching, centroids, camera, catalogue)
    miss_rad = np.linalg.norm(catalogue.guides.unit[rows] @ cam_from_icrs.T - matching.unit_cam[chosen], axis=1)
    misfit = proof.misfit(miss_rad, p.residual_tolerance_rad, camera.pixel_rad)
    if misfit:
        return proof.rejected(misfit)
    visible = in_view(catalogue, camera, cam_from_icrs)
    extra, guide = confirmed(matching, centroids, cam_from_icrs, visible, camera, catalogue, p)
    probability = false_match_probability(matching, centroids, len(extra), len(visible), camera, catalogue, p)
    looked_for = visible if matching.looked_for is None else matching.looked_for
    stars = census(cam_from_icrs, looked_for, centroids, camera, catalogue, p)
    reason = (
        _off_hint(matching.mode, hint, cam_from_icrs, camera, catalogue, p)
        or _too_probable(probability, matching, len(extra), p)
        or _unlike_the_sky(stars, matching, len(extra), p)
        or _another_focal_length(matching, centroids, catalogue, camera, p)
    )
    if reason:
        return proof.rejected(reason, probability)
    named, rows = np.concatenate([chosen, extra]), np.concatenate([rows, guide])
    weight = np.concatenate([matching.weight[chosen], np.zeros(len(extra))])
    seen_px = camera.project(catalogue.guides.unit[rows] @ cam_from_icrs.T)
    residual_px, sigma_px = centroids.pixels[named] - seen_px, centroids.sigma_px[named]
    unit, first = matching.unit_cam[chosen], catalogue.guides.unit[rows[: len(chosen)]]
    reason = (
        proof.undetermined(covariance, residual_px, sigma_px, camera)
        or proof.displaced(unit, centroids.sigma_px[chosen], first, camera, cam_from_icrs)
        or proof.few_identified(len(named), len(centroids), probability, catalogue.guides.unit, cam_from_icrs, camera)
    )
    if reason and p.acceptance != "document":
        return proof.rejected(reason, probability)
    attitude = Attitude(quaternion_from_matrix(cam_from_icrs), covariance)
    return proof.solved(attitude, probability, centroids, named, catalogue.bank.hip[rows], weight, seen_px)


def _another_focal_length(
    matching: SunsatMatching, centroids: Centroids, catalogue: SunsatCatalogue, camera: Camera, p: SunsatParameters
) -> str:
    """Return why the focal length could be wrong, or "". This test is not in the document. It was added because three
    stars in a corner can also fit another focal length and a wrong boresight."""
    if p.acceptance == "document":
        return ""
    chosen, bank = matching.selected, catalogue.guides.unit
    reference, radius_px = bank[matching.row[chosen]], FOCAL_TOLERANCES * p.distance_tolerance_rad / camera.pixel_rad
    return proof.another_focal_length(centroids.pixels, matching.unit_cam, chosen, reference, bank, camera, radius_px)


def _triad(
    matching: SunsatMatching, centroids: Centroids, camera: Camera, catalogue: SunsatCatalogue
) -> tuple[Array, Array]:
    """Return the attitude from the pair with weight, and its covariance. TRIAD maps the first star exactly, so the
    better measured star is first."""
    sigma_rad = centroids.sigma_px * camera.pixel_rad
    pair = sorted(np.flatnonzero(matching.weight > 0).tolist(), key=lambda k: (sigma_rad[k], k))
    unit = matching.unit_cam[pair]
    covariance = triad_covariance_rad2(unit[0], unit[1], sigma_rad[pair[0]], sigma_rad[pair[1]])
    return triad(unit, catalogue.guides.unit[matching.row[pair]]), covariance


def triad_covariance_rad2(first: Array, second: Array, sigma_first_rad: float, sigma_second_rad: float) -> Array:
    """Return the (3, 3) covariance of the rotation vector, camera frame, of TRIAD with ``first`` mapped exactly
    (Shuster and Oh 1981)."""
    across2 = float(np.sum(cross(first, second) ** 2))
    mixed = np.outer(first, second) + np.outer(second, first)
    about = sigma_first_rad**2 * float(first @ second) * mixed
    about += (sigma_second_rad**2 - sigma_first_rad**2) * np.outer(first, first)
    return np.asarray(sigma_first_rad**2 * np.eye(3) + about / across2)


def _too_probable(probability: float, matching: SunsatMatching, confirming: int, p: SunsatParameters) -> str:
    if p.acceptance == "document" or probability <= p.max_false_probability:
        return ""
    return (
        f"{len(matching.selected)} of {len(matching.row)} stars matched, {confirming} more confirmed, could be accidental: "
        f"bound {probability:.1e}, allowed {p.max_false_probability:.0e}"
    )


def _unlike_the_sky(stars: Census, matching: SunsatMatching, confirming: int, p: SunsatParameters) -> str:
    """Return why the census of expected stars contradicts the match, or "".

    A few stars can fit by chance, especially in a mirrored frame. In this case other expected stars are missing. If
    many stars match, a few missing stars are tolerated. Displaced stars indicate another camera, even if many stars
    match in one corner.
    """
    identified = len(matching.selected) + confirming
    if p.acceptance == "document":
        return ""
    is_few = identified < p.sure_named
    if stars.displaced * 4 > (0 if is_few else max(stars.expected, 4)):
        return f"{stars.displaced} of {stars.expected} bright stars in view are not at their expected positions"
    spare = 1 if len(matching.selected) >= p.min_group else 0
    too_many = stars.absent > spare and stars.absent * 2 >= identified * spare
    if (is_few and too_many) or stars.absent * 4 > 3 * max(stars.expected, 4):
        return f"{identified} stars match, but {stars.absent} of {stars.expected} bright stars that should be in view are missing"
    if matching.looked_for is not None and not confirming and len(matching.looked_for) > p.confirm_windows + 1:
        return f"none of {len(matching.looked_for) - len(matching.selected)} further expected stars confirms the match"
    return ""


def _off_hint(
    mode: Mode,
    hint: AttitudePrior | None,
    cam_from_icrs: Array,
    camera: Camera,
    catalogue: SunsatCatalogue,
    p: SunsatParameters,
) -> str:
    """Return why the attitude disagrees with the hint, or ""."""
    if mode is Mode.LOST_IN_SPACE or hint is None:
        return ""
    if mode is Mode.TRACKING:
        off_px, limit_px = off_prediction_px(cam_from_icrs, camera, catalogue, p, hint)
        return "" if off_px <= limit_px else f"attitude is {off_px:.0f} px from the expected; {limit_px:.0f} px allowed"
    return proof.off_hint(hint, cam_from_icrs, p.hint_error_rad)
