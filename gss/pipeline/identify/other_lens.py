"""Identification with a known camera whose lens differs from its calibration, as at first light or after a thermal shock.

The search is repeated at focal lengths around the calibrated one. Each identification is verified with a free focal
length and centre that lie near the calibration.
"""

from __future__ import annotations

import math

import numpy as np

from gss.domain.camera import Camera
from gss.domain.results import Centroids
from gss.pipeline.identify.blind_proof import BlindSolution, prove
from gss.pipeline.identify.pyramid import ACCEPT, identify_lost
from gss.pipeline.identify.verify import Evidence, FrameDetections, SkyCatalogue, field_of, verify
from gss.pipeline.refine import Refined, refine
from gss.skytables.pairs import DistanceTable

STEP = 0.0025
LARGEST = 0.0325
"""Largest relative difference of the focal length that is searched, a little more than 3 %."""
STEPS = round(LARGEST / STEP)
SCALES = (1.0, *(1 + sign * k * STEP for k in range(1, STEPS + 1) for sign in (1, -1)))
"""Focal lengths of the search relative to the calibration, nearest first."""
CANDIDATE = 1e-2  # limit of a candidate's false-match probability; the verification decides
LIMIT = ACCEPT / 2  # because there are two verifications
FEW = 5  # with fewer stars, a free focal length leaves too little evidence
FITTED_SCALES = 325
"""Number of focal lengths in the range that differ by 0.1 px at 500 px. A fitted focal length is as good as the best of
these, so each is a hypothesis."""
CENTRE = ("col", "row")
MAX_CENTRE_PX = 40.0
"""Largest difference of the optical centre, twice what is expected at first light."""
MAX_RMS_PX, MAX_RMS_SIGMA = 0.5, 3.0
"""A correct fit has residuals below the larger of these limits, the second relative to the position errors."""


def identify_other_lens(
    centroids: Centroids, camera: Camera, sky: SkyCatalogue, pairs: DistanceTable, *, fast: bool | None = None
) -> BlindSolution | None:
    """Identify a frame at focal lengths within ``LARGEST`` of the calibrated ``camera``. None if no star pattern matches.

    ``pairs``: distance table of ``sky`` for the camera. The camera of the result has the fitted focal length and optical
    centre, and the fitted ``k1`` of a Brown lens if enough stars are identified. ``fast``: see
    :func:`gss.pipeline.kernels.kernels`.
    """
    if len(centroids) < FEW:
        return None
    magnitude = -2.5 * np.log10(np.maximum(centroids.flux_dn, 1e-12))
    for scale in SCALES:
        scaled = camera if scale == 1.0 else camera.with_focal_scaled(scale)
        view = field_of(centroids, scaled)
        match = identify_lost(view, sky, pairs, scaled, scale_error=STEP / 2, accept=CANDIDATE, fast=fast)
        if match.evidence is None:
            continue
        hypotheses = max(1, match.hypotheses)
        solutions = (
            prove(
                scaled,
                match.evidence.cam_from_icrs,
                centroids.pixels,
                magnitude,
                centroids.sigma_px,
                sky,
                hypotheses * len(SCALES),
                CENTRE,
                camera,
            ),
            _few_stars(centroids, view, scaled, camera, match.evidence, sky, hypotheses),
        )
        for solution in solutions:
            if (
                solution is not None
                and solution.false_match_probability <= LIMIT
                and _is_plausible(solution, view, camera)
            ):
                return solution
    return None


def lens_difference(fit: Refined, calibrated: Camera) -> str:
    """Describe how a fitted lens differs from its calibration. ``fit`` has a free focal length and optical centre."""
    percent = 100 * (fit.camera.focal_col_px / calibrated.focal_col_px - 1)
    sigma = dict(zip(fit.parameters, np.sqrt(np.diag(fit.covariance)), strict=True))
    off_col = fit.camera.centre_col_px - calibrated.centre_col_px
    off_row = fit.camera.centre_row_px - calibrated.centre_row_px
    return (
        f"the lens differs from its calibration: focal length {percent:+.2f} ± {100 * sigma['focal']:.2f} %, optical "
        f"centre {off_col:+.1f} ± {sigma['col'] * fit.camera.focal_col_px:.1f} px in column and "
        f"{off_row:+.1f} ± {sigma['row'] * fit.camera.focal_row_px:.1f} px in row. Calibrate the camera"
    )


def _few_stars(
    centroids: Centroids,
    view: FrameDetections,
    scaled: Camera,
    calibration: Camera,
    evidence: Evidence,
    sky: SkyCatalogue,
    hypotheses: int,
) -> BlindSolution | None:
    """Verify with the small acceptance radius of a known camera, after a fit of the focal length alone."""
    fit = _fit(view, evidence, sky, scaled)
    if fit is None:
        return None
    fitted_view, used = field_of(centroids, fit.camera), fit.weight > 0
    if len(fitted_view) != len(view):
        return None  # a position is outside the domain of only one of the two lenses, so the rows differ
    again = verify(
        fitted_view,
        sky,
        fit.camera,
        rows=evidence.rows[used],
        stars=evidence.stars[used],
        hypotheses=hypotheses * FITTED_SCALES,
    )
    fit = None if again is None else _fit(fitted_view, again, sky, fit.camera, CENTRE, calibration)
    if again is None or fit is None:
        return None
    return BlindSolution(
        fitted_view.centroid[again.rows], again.stars, fit, again.predicted, again.false_match_probability
    )


def _fit(
    view: FrameDetections,
    evidence: Evidence,
    sky: SkyCatalogue,
    camera: Camera,
    lens: tuple[str, ...] = (),
    calibration: Camera | None = None,
) -> Refined | None:
    """Fit attitude, focal length and ``lens``. None with fewer than ``FEW`` stars."""
    rows = evidence.rows
    if len(rows) < FEW:
        return None
    try:
        fit = refine(
            view.pixels[rows],
            sky.icrs[evidence.stars],
            view.sigma_px[rows],
            camera,
            evidence.cam_from_icrs,
            fit_focal=True,
            fit_lens=lens,
            calibration=calibration,
        )
    except np.linalg.LinAlgError:
        return None
    return fit if int((fit.weight > 0).sum()) >= FEW else None


def _is_plausible(solution: BlindSolution, view: FrameDetections, calibration: Camera) -> bool:
    """True if the fitted camera is near the calibration and its residuals are small."""
    camera = solution.fit.camera
    focal = abs(math.log(camera.focal_col_px / calibration.focal_col_px))
    centre_px = math.hypot(
        camera.centre_col_px - calibration.centre_col_px, camera.centre_row_px - calibration.centre_row_px
    )
    max_rms_px = max(MAX_RMS_PX, MAX_RMS_SIGMA * view.typical_sigma_px)
    return focal <= LARGEST + STEP and centre_px <= MAX_CENTRE_PX and solution.fit.rms_px <= max_rms_px
