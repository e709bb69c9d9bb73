"""The chain of FAR-MST (Huffman 2006 ch. 4–6): attitude from matched stars, and the sequence of steps.

``far_mst_parameters.SOURCES`` documents, for each parameter, what the document leaves open and the tests added against
false attitudes.
"""

from __future__ import annotations

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.results import Attitude, Centroids, Matches
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix
from gss.pipeline.attitude import covariance_rad2, foam, q_method, quest, svd
from gss.pipeline.chains.far_mst_catalogue import FarMstCatalogue
from gss.pipeline.chains.far_mst_match import FarMstMatching
from gss.pipeline.chains.far_mst_parameters import FarMstParameters
from gss.pipeline.chains.far_mst_verify import star_radius_rad
from gss.pipeline.chains.onboard import Solution
from gss.pipeline.identify.focal_census import focal_objection

NOTHING = float("nan")


def calculate_attitude(
    matching: FarMstMatching,
    centroids: Centroids,
    camera: Camera,
    catalogue: FarMstCatalogue,
    parameters: FarMstParameters,
) -> Solution:
    """Compute the attitude from the selected stars with weights 1/σ² (Huffman 2006 eq. 6.34–6.36). No attitude is given if one
    star does not fit or the field fits another focal length."""
    probability = matching.false_match_probability
    if matching.reason:
        return Solution(None, None, probability, matching.reason)
    chosen = matching.selected
    row, unit = matching.row[chosen], matching.unit_cam[chosen]
    reference, weight = catalogue.icrs[row], matching.weight[chosen]
    quaternion = attitude_of(unit, reference, weight, parameters.attitude_method)
    seen = reference @ matrix_from_quaternion(quaternion).T
    sigma_rad = np.maximum(centroids.sigma_px[chosen], 1e-3) * camera.pixel_rad
    if parameters.acceptance == "bound":
        off = np.linalg.norm(seen - unit, axis=1) / star_radius_rad(sigma_rad, camera.pixel_rad, parameters)
        if off.max() > 1.5:
            pixels = float(np.max(np.linalg.norm(seen - unit, axis=1))) / camera.pixel_rad
            return Solution(
                None, None, probability, f"matched stars do not fit one attitude: one is {pixels:.1f} px off"
            )
        another = _another_focal_length(matching, centroids, camera, catalogue, parameters, sigma_rad)
        if another:
            return Solution(None, None, probability, another)
    residual_px = centroids.pixels[chosen] - camera.project(seen)
    matches = Matches(
        chosen.astype(np.int32), catalogue.bank.hip[row].astype(np.int32), weight / weight.sum(), residual_px
    )
    return Solution(Attitude(quaternion, covariance_rad2(unit, sigma_rad)), matches, probability, "")


def _another_focal_length(
    matching: FarMstMatching,
    centroids: Centroids,
    camera: Camera,
    catalogue: FarMstCatalogue,
    parameters: FarMstParameters,
    sigma_rad: Array,
) -> str:
    good = np.flatnonzero(np.isfinite(matching.unit_cam).all(axis=1))
    met, reference = np.searchsorted(good, matching.selected), catalogue.icrs[matching.row[matching.selected]]
    radius_px = float(np.max(star_radius_rad(sigma_rad, camera.pixel_rad, parameters))) / camera.pixel_rad
    return focal_objection(centroids.pixels[good], met, reference, catalogue.icrs, camera, radius_px)


def attitude_of(observed: Array, reference: Array, weight: Array, method: str) -> Array:
    """(4,) quaternion cam_from_icrs by the named method; all four minimise Wahba's loss."""
    if method in ("quest", "q_method"):
        return (quest if method == "quest" else q_method)(observed, reference, weight)
    return quaternion_from_matrix((svd if method == "svd" else foam)(observed, reference, weight))
