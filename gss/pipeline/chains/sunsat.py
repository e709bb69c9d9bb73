"""The chain of the Sunsat star sensor (Jacobs 1995 ch. 2–4): region growing, match groups, tracking in windows, TRIAD.

Nothing is remembered between calls: what the tracker knows from before comes in as the hint. What the document leaves open,
and what we add against false attitudes, is said for each parameter in ``sunsat_parameters.SOURCES``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.results import Attitude, Centroids, Matches
from gss.domain.rotation import quaternion_from_matrix
from gss.pipeline.attitude import triad
from gss.pipeline.chains.modes import Hint, Mode
from gss.pipeline.chains.onboard import Detection, Solution
from gss.pipeline.chains.sunsat_bound import confirmed, false_match_probability, in_view
from gss.pipeline.chains.sunsat_detect import brightest, dark_rows_dn, find_stars
from gss.pipeline.chains.sunsat_match import SunsatCatalogue, SunsatMatching, candidates
from gss.pipeline.chains.sunsat_parameters import SunsatParameters
from gss.pipeline.regions import Pixels


def find_in_frame(pixels: Pixels, parameters: SunsatParameters) -> Detection:
    """Stars in a whole frame (Jacobs 1995 §2.2)."""
    dark_dn = dark_rows_dn(pixels, parameters.dark_clip_dn, parameters.search_step_px)
    found = find_stars(pixels.astype(np.float32) - dark_dn.astype(np.float32)[:, None], parameters)
    centroids = found.centroids.take(brightest(found.centroids))
    notes = (found.stopped,) if found.stopped else ()
    return Detection(found.regions, centroids, found.invalid, float(np.median(dark_dn)), notes)


def match_stars(
    centroids: Centroids,
    camera: Camera,
    catalogue: SunsatCatalogue,
    parameters: SunsatParameters,
    mode: Mode,
    hint: Hint | None,
) -> SunsatMatching:
    """Names for stars, lost in space or assisted (Jacobs 1995 ch. 3).

    The document takes the brightest eight and the largest group. With acceptance by bound, a group whose attitude does not
    stand up to it is not the answer: other groups as large are looked at, then the next eight stars, half of them new.
    """
    p = parameters
    every: list[SunsatMatching] = []
    rounds = p.max_rounds if p.acceptance == "bound" else 1
    for first in range(0, rounds * p.max_observed // 2, max(1, p.max_observed // 2)):
        if first and len(centroids) < first + p.min_group:
            break
        before = (every[-1].hypotheses, every[-1].operations) if every else (0.0, 0)
        tried = [
            replace(m, hypotheses=m.hypotheses + before[0], operations=m.operations + before[1])
            for m in candidates(centroids, camera, catalogue, p, mode, hint, first)
        ]
        if p.acceptance == "document":
            return tried[0]
        sure = [m for m in tried if calculate_attitude(m, centroids, camera, catalogue, p, hint).attitude is not None]
        if sure and _same_attitude(sure):
            return sure[0]
        every.append(tried[0])
    return replace(every[0], operations=every[-1].operations)


def _same_attitude(sure: list[SunsatMatching]) -> bool:
    """Do they name two stars alike?"""
    names = [set(zip(m.selected.tolist(), m.row[m.selected].tolist(), strict=True)) for m in sure]
    return all(len(names[0] & other) > 1 for other in names[1:])


def calculate_attitude(
    matching: SunsatMatching,
    centroids: Centroids,
    camera: Camera,
    catalogue: SunsatCatalogue,
    parameters: SunsatParameters,
    hint: Hint | None = None,
) -> Solution:
    """TRIAD on the two matched stars farthest apart (§4.1.6.1), and the checks that keep a false attitude from leaving the
    chain: every matched star must fit, the boresight must be where the hint allows, an accident must be improbable.

    Matches hold the group, of which TRIAD's pair has weight one, and, with no weight, the stars that only confirm it.
    """
    p, chosen = parameters, matching.selected
    if matching.reason:
        return Solution(None, None, float("nan"), matching.reason)
    rows, unit = matching.row[chosen], matching.unit_cam[chosen]
    reference = catalogue.guides.unit[rows]
    sigma_rad = centroids.sigma_px[chosen] * camera.pixel_rad
    first, second = _triad_pair(matching, sigma_rad)
    cam_from_icrs = triad(unit[[first, second]], reference[[first, second]])
    miss_rad = np.linalg.norm(reference @ cam_from_icrs.T - unit, axis=1)
    if np.max(miss_rad) > p.residual_tolerance_rad:
        off_px = float(np.max(miss_rad)) / camera.pixel_rad
        return Solution(None, None, float("nan"), f"matched stars do not fit one attitude: one is {off_px:.1f} px off")
    visible = in_view(catalogue, camera, cam_from_icrs)
    visible = visible[~np.isin(visible, rows)]
    predicted = catalogue.guides.unit[visible] @ cam_from_icrs.T
    extra, at = confirmed(
        matching, centroids, predicted, catalogue.guides.v_mag[visible], camera.unproject(centroids.pixels), p
    )
    probability = false_match_probability(
        matching, centroids, len(extra), len(visible) + len(rows), camera, catalogue, p
    )
    reason = _off_hint(matching.mode, hint, cam_from_icrs, p) or _too_probable(probability, matching, len(extra), p)
    if reason:
        return Solution(None, None, probability, reason)
    covariance = triad_covariance_rad2(unit[first], unit[second], sigma_rad[first], sigma_rad[second])
    named, rows = np.concatenate([chosen, extra]), np.concatenate([rows, visible[at]])
    weight = np.concatenate([matching.weight[chosen], np.zeros(len(extra))])
    residual_px = centroids.pixels[named] - camera.project(catalogue.guides.unit[rows] @ cam_from_icrs.T)
    matches = Matches(named.astype(np.int32), catalogue.bank.hip[rows].astype(np.int32), weight, residual_px)
    return Solution(Attitude(quaternion_from_matrix(cam_from_icrs), covariance), matches, probability, "")


def _triad_pair(matching: SunsatMatching, sigma_rad: Array) -> tuple[int, int]:
    """Places of the pair among the selected stars; the better measured one first, since TRIAD meets that one exactly."""
    pair = np.flatnonzero(matching.weight[matching.selected] > 0).tolist()
    first, second = sorted(pair, key=lambda k: (sigma_rad[k], k))
    return first, second


def triad_covariance_rad2(first: Array, second: Array, sigma_first_rad: float, sigma_second_rad: float) -> Array:
    """(3, 3) covariance of the rotation vector, camera frame, of TRIAD with ``first`` met exactly (Shuster and Oh 1981)."""
    across2 = float(np.sum(np.cross(first, second) ** 2))
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


def _off_hint(mode: Mode, hint: Hint | None, cam_from_icrs: Array, p: SunsatParameters) -> str:
    if mode is not Mode.ASSISTED or hint is None:
        return ""
    boresight = np.asarray(hint.boresight_icrs, float)
    off_rad = float(2 * np.arcsin(np.linalg.norm(boresight / np.linalg.norm(boresight) - cam_from_icrs[2]) / 2))
    if off_rad <= p.hint_error_rad:
        return ""
    return f"boresight is {np.degrees(off_rad):.1f}° from the hint; {np.degrees(p.hint_error_rad):.1f}° allowed"
