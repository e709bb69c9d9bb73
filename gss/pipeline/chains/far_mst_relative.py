"""FAR-MST without a catalogue: rotation between two frames, and attitudes chained from it (Huffman 2006 §5.5, §7.2).

The choice of matcher follows the reconstructed Fig. 8.2: rate match if the rotation is predicted, else triangle match,
or pair match for two stars. The module has no state; the caller passes both frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.results import Attitude, Centroids
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix
from gss.pipeline.attitude import covariance_rad2
from gss.pipeline.chains.far_mst import attitude_of
from gss.pipeline.chains.far_mst_parameters import FarMstParameters
from gss.pipeline.identify.accidental import accidental_bound, chance_within
from gss.pipeline.identify.frame_matching import Rows, pair_match, triangle_match
from gss.pipeline.track.rate_match import rate_match

METHODS = ("auto", "pair", "triangle", "rate")


@dataclass(frozen=True)
class Relative:
    """Rotation from one frame to the next. ``quaternion``: new camera from old, or None with a ``reason``.
    ``covariance_rad2``: (3, 3) of the small rotation vector in the new camera frame. ``pairs``: (m, 2) stars (before,
    after). ``false_match_probability``: upper bound; 1 for two stars, whose distance can agree by chance."""

    quaternion: Array | None
    covariance_rad2: Array
    pairs: Rows
    method: str
    false_match_probability: float
    reason: str


def relative_attitude(
    before: Centroids,
    after: Centroids,
    camera: Camera,
    parameters: FarMstParameters,
    method: str = "auto",
    expected: Array | None = None,
) -> Relative:
    """Return the rotation between two frames. ``expected``: (4,) quaternion new from old for the rate match, e.g. the
    rotation of the previous interval.

    With ``acceptance`` "document", the result contains the pairs of the matcher. Otherwise the pairs are extended to
    all stars that agree, and the false-match bound must be met. Two stars alone cannot meet the bound.
    """
    if method not in METHODS:
        raise BadInput("unknown frame-to-frame matcher", expected=" | ".join(METHODS), got=method)
    if method == "rate" and expected is None:
        raise BadInput("the rate match needs the rotation of the previous interval", expected="a quaternion")
    frames = (_stars(before, camera, parameters), _stars(after, camera, parameters))
    answer = _nothing("", "too few stars in one of the frames")
    for hypothesis in _order(method, len(frames[0][0]), len(frames[1][0]), expected):
        pairs = _pairs(hypothesis, before, after, frames, camera, parameters, expected)
        answer = _solved(hypothesis, pairs, frames, camera, parameters)
        if answer.quaternion is not None:
            break
    return answer


def chained(attitude: Attitude, relative: Relative) -> Attitude:
    """Return the attitude of the next frame: q_j = Δq q_i (eq. 7.2). Errors are added as ε_j² = ε_i² + ε_ij² (eq. 7.1),
    with covariance matrices instead of squares."""
    if relative.quaternion is None:
        raise BadInput("there is no rotation to chain", expected="a solved relative attitude", got=relative.reason)
    turn = matrix_from_quaternion(relative.quaternion)
    quaternion = quaternion_from_matrix(turn @ attitude.cam_from_icrs)
    return Attitude(quaternion, turn @ attitude.covariance_rad2 @ turn.T + relative.covariance_rad2)


def _stars(centroids: Centroids, camera: Camera, p: FarMstParameters) -> tuple[Array, Array]:
    """Return (n, 3) directions and (n,) σ in rad of the stars used."""
    used = centroids.take(np.arange(min(len(centroids), p.max_centroids)))
    unit = camera.unproject(used.pixels) if len(used) else np.empty((0, 3))
    if not np.isfinite(unit).all():
        raise BadInput("a centroid lies outside the lens distortion's domain", expected="centroids on the detector")
    return unit, np.maximum(used.sigma_px, 1e-3) * camera.pixel_rad


def _order(method: str, stars_before: int, stars_after: int, expected: Array | None) -> tuple[str, ...]:
    fewest = min(stars_before, stars_after)
    if fewest < 2:
        return ()
    if method != "auto":
        return (method,)
    predicted = ("rate",) if expected is not None else ()
    return (*predicted, "pair") if fewest == 2 else (*predicted, "triangle")


def _pairs(
    method: str,
    before: Centroids,
    after: Centroids,
    frames: tuple[tuple[Array, Array], tuple[Array, Array]],
    camera: Camera,
    p: FarMstParameters,
    expected: Array | None,
) -> Rows:
    (old, old_sigma), (new, new_sigma) = frames
    # The difference between two measured angles contains the noise of four positions.
    tolerance = float(p.sigmas * np.sqrt(2 * (np.median(old_sigma) ** 2 + np.median(new_sigma) ** 2)))
    if method == "rate" and expected is not None:
        return rate_match(old, new, matrix_from_quaternion(expected), camera, p.tracking_radius_rad)
    if method == "pair":
        return pair_match(old, new, before.flux_dn, after.flux_dn, tolerance)
    return triangle_match(old, new, tolerance, p.most_figures[0])


def _solved(
    method: str,
    pairs: Rows,
    frames: tuple[tuple[Array, Array], tuple[Array, Array]],
    camera: Camera,
    p: FarMstParameters,
) -> Relative:
    (old, old_sigma), (new, new_sigma) = frames
    if len(pairs) < 2:
        return _nothing(method, f"the {method} match found no partners")
    quaternion, sigma = _fit(pairs, frames, p)
    if p.acceptance == "document":
        return Relative(quaternion, covariance_rad2(new[pairs[:, 1]], sigma), pairs, method, float("nan"), "")
    radius = (
        p.sigmas * 1.15 * float(np.hypot(np.median(old_sigma), np.median(new_sigma))) + p.floor_px * camera.pixel_rad
    )
    for widening in (3.0, 1.5, 1.0):
        pairs = rate_match(old, new, matrix_from_quaternion(quaternion), camera, widening * radius)
        if len(pairs) < 2:
            return _nothing(method, "the matched stars do not fit a single rotation")
        quaternion, sigma = _fit(pairs, frames, p)
    fov_h, fov_v = camera.fov_rad
    chance = chance_within(len(new) / float(4 * np.arcsin(np.sin(fov_h / 2) * np.sin(fov_v / 2))), 1.5 * radius)
    same_length = len(new) * (len(new) - 1) * 2 * radius / camera.half_diagonal_rad
    bound = accidental_bound(len(old) * (len(old) - 1) / 2 * same_length, len(pairs), len(old), chance)
    if bound > p.max_false_probability:
        return _nothing(method, f"{len(pairs)} stars that agree could be accidental: bound {bound:.1e}")
    return Relative(quaternion, covariance_rad2(new[pairs[:, 1]], sigma), pairs, method, bound, "")


def _fit(
    pairs: Rows, frames: tuple[tuple[Array, Array], tuple[Array, Array]], p: FarMstParameters
) -> tuple[Array, Array]:
    """Return the (4,) quaternion, new from old, of the pairs, and (m,) σ of each pair's difference."""
    (old, old_sigma), (new, new_sigma) = frames
    sigma = np.hypot(old_sigma[pairs[:, 0]], new_sigma[pairs[:, 1]])
    return attitude_of(new[pairs[:, 1]], old[pairs[:, 0]], 1 / sigma**2, p.attitude_method), sigma


def _nothing(method: str, reason: str) -> Relative:
    return Relative(None, np.full((3, 3), np.inf), np.empty((0, 2), np.intp), method, float("nan"), reason)
