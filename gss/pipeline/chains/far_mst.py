"""The chain of FAR-MST (Huffman 2006 ch. 4–6): attitude from matched stars, and sequence of steps.

``far_mst_parameters.SOURCES`` documents, for each parameter, the choices that the document leaves open and the tests
added against false attitudes.
"""

from __future__ import annotations

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.results import Attitude, Centroids
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix
from gss.pipeline.attitude import (
    covariance_rad2,
    foam,
    foam_covariance_rad2,
    pad,
    pad_covariance_rad2,
    pixel_information,
    q_method,
    quest,
    svd,
    svd_covariance_rad2,
)
from gss.pipeline.chains import proof
from gss.pipeline.chains.far_mst_catalogue import FarMstCatalogue
from gss.pipeline.chains.far_mst_match import FarMstMatching
from gss.pipeline.chains.far_mst_parameters import FarMstParameters
from gss.pipeline.chains.far_mst_verify import star_radius_rad
from gss.pipeline.chains.onboard import OnboardSolution

MISFIT_RADII = 1.5


def calculate_attitude(
    matching: FarMstMatching,
    centroids: Centroids,
    camera: Camera,
    catalogue: FarMstCatalogue,
    parameters: FarMstParameters,
) -> OnboardSolution:
    """Compute the attitude from the selected stars with weights 1/σ² (Huffman 2006 eq. 6.34–6.36). With the
    acceptance ``bound``, no attitude is returned if a star does not fit or the field fits another focal length."""
    probability = matching.false_match_probability
    if matching.reason:
        return proof.rejected(matching.reason, probability)
    chosen = matching.selected
    row, unit = matching.row[chosen], matching.unit_cam[chosen]
    reference, weight = catalogue.icrs[row], matching.weight[chosen]
    quaternion = attitude_of(unit, reference, weight, parameters.attitude_method)
    cam_from_icrs = matrix_from_quaternion(quaternion)
    predicted = reference @ cam_from_icrs.T
    sigma_rad = np.maximum(centroids.sigma_px[chosen], 1e-3) * camera.pixel_rad
    if parameters.acceptance == "bound":
        radius_rad = star_radius_rad(sigma_rad, camera.pixel_rad, parameters)
        miss_rad, radius_px = np.linalg.norm(predicted - unit, axis=1), float(np.max(radius_rad)) / camera.pixel_rad
        reason = (
            proof.misfit(miss_rad, MISFIT_RADII * radius_rad, camera.pixel_rad)
            or proof.displaced(unit, centroids.sigma_px[chosen], reference, camera, cam_from_icrs)
            or proof.few_identified(len(chosen), len(matching.row), probability, catalogue.icrs, cam_from_icrs, camera)
            or proof.another_focal_length(
                centroids.pixels, matching.unit_cam, chosen, reference, catalogue.icrs, camera, radius_px
            )
        )
        if reason:
            return proof.rejected(reason, probability)
    covariance = covariance_of(unit, reference, sigma_rad, parameters.attitude_method)
    attitude, share = Attitude(quaternion, covariance), weight / weight.sum()
    return proof.solved(
        attitude, probability, centroids, chosen, catalogue.bank.hip[row], share, camera.project(predicted)
    )


def attitude_of(observed: Array, reference: Array, weight: Array, method: str) -> Array:
    """Return the (4,) quaternion cam_from_icrs by the named method. All methods minimise Wahba's loss, except that "pad" uses
    the anisotropic errors of directions from pixels."""
    if method == "pad":
        return quaternion_from_matrix(pad(observed, reference, pixel_information(observed, weight**-0.5)))
    if method in ("quest", "q_method"):
        return (quest if method == "quest" else q_method)(observed, reference, weight)
    return quaternion_from_matrix((svd if method == "svd" else foam)(observed, reference, weight))


def covariance_of(observed: Array, reference: Array, sigma_rad: Array, method: str) -> Array:
    """Return the (3, 3) covariance in the camera frame by the formula of the method (Huffman 2006 eqs. 6.34, 6.53, 6.58)."""
    if method == "svd":
        return svd_covariance_rad2(observed, reference, sigma_rad)
    if method == "foam":
        return foam_covariance_rad2(observed, reference, sigma_rad)
    if method == "pad":
        return pad_covariance_rad2(observed, pixel_information(observed, sigma_rad))
    return covariance_rad2(observed, sigma_rad)
