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
from gss.pipeline.refine import Refined, refine, value_of
from gss.skytables.pairs import DistanceTable

STEP = 0.0025
LARGEST = 0.0325
"""Largest relative difference of the focal length that is searched, a little more than 3 %."""
STEPS = round(LARGEST / STEP)
SCALES = (1.0, *(1 + sign * k * STEP for k in range(1, STEPS + 1) for sign in (1, -1)))
"""Focal lengths of the search relative to the calibration, nearest first."""
CANDIDATE = 1e-2  # limit of a candidate's false-match probability; the verification decides
LIMIT = ACCEPT / 3  # because there are three verifications
FEW = 5  # with fewer stars, a free focal length leaves too little evidence
BUDGET = 1_300_000  # hypotheses per focal length
FITTED_SCALES = 325
"""Number of focal lengths in the range that differ by 0.1 px at 500 px. A fitted focal length is as good as the best of
these, so each is a hypothesis."""
CENTRE = ("col", "row")
MAX_CENTRE_PX = 40.0
"""Largest difference of the optical centre, twice what is expected at first light."""
CENTRE_CHI2 = 25.0
"""Minimum χ² (two degrees of freedom, by chance in 4e-6) of the fitted centre's difference from the calibration. In a wide
field, the stars determine the centre to about 5 px, and an error of the centre is an error of the boresight."""
MIN_SIGMA_PX, RESIDUAL_PENALTY = 0.1, 2.0
MAX_RMS_PX, MAX_RMS_SIGMA = 0.5, 3.0
"""A correct fit has residuals below the larger of these limits, the second relative to the position errors."""


def identify_other_lens(
    centroids: Centroids, camera: Camera, sky: SkyCatalogue, pairs: DistanceTable, *, fast: bool | None = None
) -> BlindSolution | None:
    """Identify a frame at focal lengths within ``LARGEST`` of the calibrated ``camera``. None if no star pattern matches.

    ``pairs``: distance table of ``sky`` for the camera. The camera of the result has the fitted focal length, the
    fitted optical centre if the stars require it, and the fitted ``k1`` of a Brown lens if enough stars are identified.
    ``fast``: see :func:`gss.pipeline.kernels.kernels`.
    """
    if len(centroids) < FEW:
        return None
    magnitude = -2.5 * np.log10(np.maximum(centroids.flux_dn, 1e-12))
    for scaled in camera.with_focal_scales(SCALES):
        view = field_of(centroids, scaled, fast=fast)
        match = identify_lost(
            view,
            sky,
            pairs,
            scaled,
            scale_error=STEP / 2,
            accept=CANDIDATE,
            support=FEW - 2,
            budget=BUDGET,
            only_first=True,
            fast=fast,
        )
        if match.evidence is None:
            continue
        hypotheses = max(1, match.hypotheses)
        fixed, free = (
            prove(
                scaled,
                match.evidence.cam_from_icrs,
                centroids.pixels,
                magnitude,
                centroids.sigma_px,
                sky,
                hypotheses * len(SCALES),
                lens,
                camera,
            )
            for lens in ((), CENTRE)
        )
        few = _few_stars(centroids, view, scaled, match.evidence, sky, hypotheses, fast)
        if free is not None and not _centre_differs(free.fit, camera):
            free = None
        found = [
            solution for solution in (fixed, free, few) if solution is not None and _is_proved(solution, view, camera)
        ]
        if found:
            return max(found, key=lambda solution: _merit(solution, view))
    return None


def lens_difference(fit: Refined, calibrated: Camera) -> str:
    """Describe how a fitted lens differs from its calibration. ``fit`` has a free focal length."""
    percent = 100 * (fit.camera.focal_col_px / calibrated.focal_col_px - 1)
    sigma = dict(zip(fit.parameters, np.sqrt(np.diag(fit.covariance)), strict=True))
    text = f"solved with a fitted lens: focal length {percent:+.2f} ± {100 * sigma['focal']:.2f} % from the calibration"
    if CENTRE[0] in sigma:
        off_col = fit.camera.centre_col_px - calibrated.centre_col_px
        off_row = fit.camera.centre_row_px - calibrated.centre_row_px
        text += (
            f", optical centre {off_col:+.1f} ± {sigma['col'] * fit.camera.focal_col_px:.1f} px in column and "
            f"{off_row:+.1f} ± {sigma['row'] * fit.camera.focal_row_px:.1f} px in row"
        )
    return f"{text}. Calibrate the camera"


def _few_stars(
    centroids: Centroids,
    view: FrameDetections,
    scaled: Camera,
    evidence: Evidence,
    sky: SkyCatalogue,
    hypotheses: int,
    fast: bool | None,
) -> BlindSolution | None:
    """Verify with the small acceptance radius of a known camera, after a fit of the focal length alone."""
    fit = _fit(view, evidence, sky, scaled)
    if fit is None:
        return None
    fitted_view, used = field_of(centroids, fit.camera, fast=fast), fit.weight > 0
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
    fit = None if again is None else _fit(fitted_view, again, sky, fit.camera)
    if again is None or fit is None:
        return None
    return BlindSolution(
        fitted_view.centroid[again.rows], again.stars, fit, again.predicted, again.false_match_probability
    )


def _fit(view: FrameDetections, evidence: Evidence, sky: SkyCatalogue, camera: Camera) -> Refined | None:
    """Fit attitude and focal length. None with fewer than ``FEW`` stars."""
    rows = evidence.rows
    if len(rows) < FEW:
        return None
    icrs, start = sky.icrs[evidence.stars], evidence.cam_from_icrs
    try:
        fit = refine(view.pixels[rows], icrs, view.sigma_px[rows], camera, start, fit_focal=True)
    except np.linalg.LinAlgError:
        return None
    return fit if int((fit.weight > 0).sum()) >= FEW else None


def _merit(solution: BlindSolution, view: FrameDetections) -> float:
    """Return the number of identified stars minus a penalty for residuals."""
    excess = max(solution.fit.rms_px / max(view.typical_sigma_px, MIN_SIGMA_PX), 1.0) - 1.0
    return float(np.count_nonzero(solution.fit.weight) - RESIDUAL_PENALTY * excess)


def _centre_differs(fit: Refined, calibration: Camera) -> bool:
    """True if the stars require another optical centre than the calibrated one."""
    if CENTRE[0] not in fit.parameters:
        return False
    index = [fit.parameters.index(name) for name in CENTRE]
    off = np.array([value_of(fit.camera, name) - value_of(calibration, name) for name in CENTRE])
    return float(off @ np.linalg.solve(fit.covariance[np.ix_(index, index)], off)) >= CENTRE_CHI2


def _is_proved(solution: BlindSolution, view: FrameDetections, calibration: Camera) -> bool:
    """True if the match is not accidental, the fitted camera is near the calibration, and the residuals are small."""
    camera = solution.fit.camera
    focal = abs(math.log(camera.focal_col_px / calibration.focal_col_px))
    centre_px = math.hypot(
        camera.centre_col_px - calibration.centre_col_px, camera.centre_row_px - calibration.centre_row_px
    )
    max_rms_px = max(MAX_RMS_PX, MAX_RMS_SIGMA * view.typical_sigma_px)
    is_near = focal <= LARGEST + STEP and centre_px <= MAX_CENTRE_PX
    return solution.false_match_probability <= LIMIT and is_near and solution.fit.rms_px <= max_rms_px
