"""Proof stage of the on-board chains: tests that an attitude must pass, and construction of the solution.

Each test returns the reason to reject the attitude, or "". A chain chooses its tests and their limits; see its
``SOURCES``.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from gss.domain.angles import Array
from gss.domain.camera import Camera, Pinhole
from gss.domain.results import Attitude, Centroids, Matches
from gss.domain.rotation import matrix_from_quaternion, rotation_angle_rad
from gss.pipeline.chains.modes import AttitudePrior
from gss.pipeline.chains.onboard import OnboardSolution
from gss.pipeline.identify.focal_census import focal_objection
from gss.pipeline.identify.soundness import is_few, is_handed
from gss.pipeline.identify.verify import MIN_SIGMA_PX
from gss.pipeline.refine import DISPLACED, LEAST_FREEDOM, displacements, linearised

Rows = NDArray[np.integer]
DISPLACED_PX = 2.0
"""Distance from the predicted position up to which a star may be displaced, for example by a close companion."""
ERROR_SIGMA, MAX_ERROR_PX = 3.0, 5.0
"""Standard deviations of the boresight that must be below the error from which an attitude counts as wrong."""


def rejected(reason: str, probability: float = float("nan")) -> OnboardSolution:
    """Return a solution without attitude. ``probability``: false-match bound, NaN if nothing was identified."""
    return OnboardSolution(None, None, probability, reason)


def solved(
    attitude: Attitude,
    probability: float,
    centroids: Centroids,
    named: Rows,
    hip: Rows,
    weight: Array,
    seen_px: Array,
) -> OnboardSolution:
    """Return the solution for the identified centroids ``named`` (k,). ``hip``: catalogue numbers of their stars;
    ``weight``: weights; ``seen_px`` (k, 2): pixels of the stars predicted by the attitude."""
    residual_px = centroids.pixels[named] - seen_px
    return OnboardSolution(
        attitude, Matches(named.astype(np.int32), hip.astype(np.int32), weight, residual_px), probability, ""
    )


def misfit(miss_rad: Array, limit_rad: Array | float, pixel_rad: float) -> str:
    """Test that all (k,) residuals are within their limits."""
    if not np.any(miss_rad > limit_rad):
        return ""
    return f"matched stars do not fit one attitude: one is {float(np.max(miss_rad)) / pixel_rad:.1f} px off"


def mirrored(unit_cam: Array, reference: Array, tolerance_rad: float) -> str:
    """Test that the pattern of (k, 3) measured directions does not also fit its mirror image."""
    handed = is_handed(unit_cam, reference, tolerance_rad)
    return "" if handed else f"{len(unit_cam)} stars in a pattern that is its own mirror image"


def displaced(unit_cam: Array, sigma_px: Array, reference: Array, camera: Camera, cam_from_icrs: Array) -> str:
    """Test that no star is far from the position predicted by the others. ``unit_cam`` (k, 3), ``sigma_px`` (k,) and
    ``reference`` (k, 3): measured directions, errors and catalogue directions of the identified stars.

    A false match far from the other stars determines the rotation about them, so its own residual is small. The positions
    are those of a camera without distortion, so that they agree with the directions from which the attitude was computed.
    """
    if 2 * (len(unit_cam) - 1) - 3 < LEAST_FREEDOM:
        return ""
    ideal, weight = replace(camera, distortion=Pinhole()), 1 / np.maximum(sigma_px, MIN_SIGMA_PX) ** 2
    residual, jacobian = linearised(ideal.project(unit_cam), reference, ideal, cam_from_icrs)
    weighted = weight[:, None, None] * jacobian
    normal = np.einsum("kai,kaj->ij", weighted, jacobian) * (1 + 1e-12 * np.eye(3))
    residual = residual - jacobian @ np.linalg.solve(normal, np.einsum("kai,ka->i", weighted, residual))
    chance, off_px = displacements(residual, jacobian, weight, normal)
    far = (chance < DISPLACED) & (off_px > DISPLACED_PX)
    if not far.any():
        return ""
    return f"one of {len(unit_cam)} stars is {off_px[far].max():.1f} px from the position predicted by the others"


def scattered(residual_px: Array, sigma_px: Array, probability: float) -> str:
    """Test that the stated errors explain the residuals of few stars better than an accidental match does. ``residual_px``
    (k, 2), ``sigma_px`` (k,); ``probability``: false-match bound. :func:`displaced` tests more stars."""
    freedom = 2 * len(residual_px) - 3
    if freedom - 2 >= LEAST_FREEDOM:
        return ""
    sigma_px = np.maximum(sigma_px, MIN_SIGMA_PX)
    chi2 = float(np.sum((residual_px / sigma_px[:, None]) ** 2))
    if chdtrc(freedom, chi2) >= probability:
        return ""
    return (
        f"the residuals of {len(residual_px)} stars are {np.sqrt(chi2 / freedom):.1f} times their errors, "
        "which is less probable than an accidental match"
    )


def off_hint(hint: AttitudePrior, cam_from_icrs: Array, limit_rad: float) -> str:
    """Test that the boresight is within ``limit_rad`` of the hint's and, if the hint is a full attitude, that the rotation
    from it is at most twice as large."""
    off_rad = boresight_error_rad(hint, cam_from_icrs)
    if off_rad > limit_rad:
        return f"boresight is {np.degrees(off_rad):.1f}° from the hint; {np.degrees(limit_rad):.1f}° allowed"
    if hint.quaternion is None:
        return ""
    turn_rad = rotation_angle_rad(cam_from_icrs, matrix_from_quaternion(hint.quaternion))
    if turn_rad <= 2 * limit_rad:
        return ""
    return f"attitude is rotated by {np.degrees(turn_rad):.1f}° from the hint; {np.degrees(2 * limit_rad):.1f}° allowed"


def undetermined(covariance_rad2: Array, residual_px: Array, sigma_px: Array, camera: Camera) -> str:
    """Test that the boresight is determined: three standard deviations are at most five pixels. ``covariance_rad2`` (3, 3):
    of the rotation vector, camera frame; ``residual_px`` (k, 2) and ``sigma_px`` (k,): of all identified stars.

    If the residuals are larger than the centroid errors, the covariance is multiplied by their reduced χ², because
    neighbouring stars that are measured as one displace a centroid by more than its noise. A few stars close together
    can then agree within a pixel although the boresight is many pixels off. A residual is NaN if its star is outside the
    domain of the lens model.
    """
    freedom = max(2 * len(residual_px) - 3, 1)
    chi2 = float(np.sum((residual_px / sigma_px[:, None]) ** 2)) / freedom
    sigma_rad = float(np.sqrt(max(chi2, 1.0) * (covariance_rad2[0, 0] + covariance_rad2[1, 1])))
    error_px = ERROR_SIGMA * sigma_rad / camera.pixel_rad
    if error_px <= MAX_ERROR_PX:
        return ""
    if np.isnan(error_px):
        return "the lens model does not give a position of every identified star"
    return (
        f"the boresight could be {error_px:.0f} px off ({ERROR_SIGMA:g} σ): the stars are close together or do not fit, "
        f"residuals {np.sqrt(chi2):.0f} σ"
    )


def accidental(selected: int, centroids: int, probability: float, allowed: float) -> str:
    """Test that the bound on the false-match probability is at most ``allowed``."""
    if probability <= allowed:
        return ""
    return (
        f"{selected} of {centroids} centroids verified could be accidental: "
        f"bound {probability:.1e}, allowed {allowed:.0e}"
    )


def few_identified(
    selected: int, centroids: int, probability: float, icrs: Array, cam_from_icrs: Array, camera: Camera
) -> str:
    """Test that the ``selected`` stars are not few of the ``centroids`` and of the (n, 3) detectable stars in the field. In a
    mirrored frame near a known attitude, three to five of thirty or more stars can match by accident."""
    if not is_few(selected, centroids, probability):
        return ""
    in_view = _in_view(icrs, cam_from_icrs, camera)
    if not is_few(selected, min(centroids, in_view), probability):
        return ""
    return f"only {selected} of {centroids} stars identified, although the list has {in_view} in this field"


def another_focal_length(
    pixels: Array, unit_cam: Array, selected: Rows, reference: Array, bank: Array, camera: Camera, radius_px: float
) -> str:
    """Test that no other focal length fits the field better. ``pixels`` (n, 2), ``unit_cam`` (n, 3): of all centroids,
    NaN if a direction is unknown; ``reference``: (k, 3) catalogue directions of the ``selected`` centroids; ``bank``:
    (m, 3) directions of all stars."""
    good = np.flatnonzero(np.isfinite(unit_cam).all(axis=1))
    return focal_objection(pixels[good], np.searchsorted(good, selected), reference, bank, camera, radius_px)


def boresight_error_rad(hint: AttitudePrior, cam_from_icrs: Array) -> float:
    """Return the angle between the boresight of the hint and the boresight of the attitude."""
    boresight = np.asarray(hint.boresight_icrs, float)
    chord = float(np.linalg.norm(boresight / np.linalg.norm(boresight) - cam_from_icrs[2]))
    return float(2 * np.arcsin(min(1.0, chord / 2)))


def hint_error_rad(camera: Camera, assisted_radius_rad: float, least_rad: float) -> float:
    """Return the maximum angle between boresight and hint: the catalogue's radius minus the field's half diagonal
    (Erlank 2013 §4.3.4), at least ``least_rad``."""
    return max(assisted_radius_rad - _field_of(camera)[0], least_rad)


def stars_per_sr(icrs: Array, cam_from_icrs: Array, camera: Camera) -> float:
    """Return the density of the (n, 3) stars in the field of view, assuming at least one star."""
    return max(1, _in_view(icrs, cam_from_icrs, camera)) / solid_angle_sr(camera)


def _in_view(icrs: Array, cam_from_icrs: Array, camera: Camera) -> int:
    return int(np.count_nonzero(camera.contains(camera.project(icrs @ cam_from_icrs.T))))


def solid_angle_sr(camera: Camera) -> float:
    """Return the solid angle of the field of view."""
    return _field_of(camera)[1]


@lru_cache(maxsize=16)
def _field_of(camera: Camera) -> tuple[float, float]:
    """Return half diagonal, rad, and solid angle, sr, of the field of view. Cached because they are equal for all frames."""
    fov_h, fov_v = camera.fov_rad
    return camera.half_diagonal_rad, float(4 * np.arcsin(np.sin(fov_h / 2) * np.sin(fov_v / 2)))
