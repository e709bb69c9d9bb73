"""Design report of one camera: a fast version while parameters change, and the full report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.catalogue_tools.design import limits_erlank, limits_huffman, limits_jacobs, limits_moniteq
from gss.catalogue_tools.design.accuracy import Accuracy, accuracy
from gss.catalogue_tools.design.baffle import BaffleGeometry, one_stage, two_stage
from gss.catalogue_tools.design.camera import DesignCamera
from gss.catalogue_tools.design.centroid_bound import psf_advice
from gss.catalogue_tools.design.curves import GRID_BEYOND_MAG, Curves, curves_of
from gss.catalogue_tools.design.in_view import (
    COMPLETE_V_MAG,
    Each,
    InView,
    affordable,
    bright_rows,
    count_stars,
    counted_pairs,
    look,
    pairs_in_view,
)
from gss.catalogue_tools.design.radiometry import (
    Blur,
    PsfAdvice,
    limit_brightest_pixel_mag,
    limit_mag,
    limit_window_mag,
    longest_exposure_s,
    motion_blur,
    saturation_mag,
)
from gss.catalogue_tools.design.trade import TradeRow, lens_trade, trade_row
from gss.catalogue_tools.envelope.envelope import Envelope
from gss.domain.angles import Array
from gss.domain.callbacks import no_progress
from gss.domain.errors import BadInput
from gss.domain.experiment import Progress
from gss.domain.stars import StarTable

MAX_COUNTED = 40.0
"""Factor by which the histogram can process more stars than a curve, because the histogram only counts the stars."""
EXCLUSION_RAD = float(np.radians(40.0))


@dataclass(frozen=True)
class DesignEffort:
    """Amount of computation.

    ``pointings``: number of pointings of the histogram; 0: use the pointings of the curves. ``looks``: number of
    pointings of curves and accuracy. ``pairs``: largest number of stars that one curve can process. ``trade_looks``:
    pointings per lens; 0: no lens trade-off.
    """

    pointings: int
    looks: int
    pairs: float
    trade_looks: int


QUICK = DesignEffort(0, 2_000, 6e4, 0)
FULL = DesignEffort(1_000_000, 20_000, 1e6, 2_000)


@dataclass(frozen=True)
class DesignRequest:
    """Input of a design report.

    ``envelope`` None: the whole sky. ``exclusion_rad``: angle of Sun or Earth from the axis for which the baffle is
    designed. ``spare_mm``: widening of the baffle's front for misalignment.
    """

    camera: DesignCamera
    envelope: Envelope | None = None
    exclusion_rad: float = EXCLUSION_RAD
    spare_mm: float = 0.0
    seed: int = 1


@dataclass(frozen=True)
class MagnitudeLimits:
    """Magnitude limit by each method. The last four limits are computed with the formulas of the documents and the
    optics of this camera."""

    in_force_mag: float
    brightest_pixel_mag: float
    window_mag: float
    saturation_mag: float
    jacobs_mag: float
    huffman_mag: float
    erlank_mag: float
    moniteq_mag: float


@dataclass(frozen=True)
class DesignReport:
    """Results for one camera.

    ``looks``: number of pointings used for the curves. ``two_stage`` None: a two-stage baffle would be too long.
    ``baffle_problem``: why there is no baffle, empty if there is one.
    """

    request: DesignRequest
    effort: DesignEffort
    limits: MagnitudeLimits
    in_view: InView
    looks: int
    curves: Curves
    accuracy: Accuracy
    blur: Blur
    psf: PsfAdvice
    longest_exposure_s: float
    one_stage: BaffleGeometry | None
    two_stage: BaffleGeometry | None
    baffle_problem: str
    trade: tuple[TradeRow, ...]
    notes: tuple[str, ...]


def limits_of(camera: DesignCamera) -> MagnitudeLimits:
    """Compute all limiting magnitudes."""
    return MagnitudeLimits(
        limit_mag(camera),
        limit_brightest_pixel_mag(camera),
        limit_window_mag(camera),
        saturation_mag(camera),
        limits_jacobs.limit_mag(camera),
        limits_huffman.limit_mag(camera),
        limits_erlank.limit_mag(camera),
        limits_moniteq.limit_mag(camera),
    )


def design(
    request: DesignRequest,
    stars: StarTable,
    effort: DesignEffort,
    *,
    each: Each = map,
    progress: Progress = no_progress,
) -> DesignReport:
    """Compute the report. ``stars``: brightest first. ``each``: ``map`` or a parallel equivalent, applied to the blocks
    of pointings. Raises BadInput if the camera detects no star."""
    camera = request.camera
    limits = limits_of(camera)
    _check(limits, stars)
    rows = bright_rows(stars, limits.in_force_mag)
    grid_rows = bright_rows(stars, limits.in_force_mag + GRID_BEYOND_MAG)
    looks = affordable(camera, grid_rows, effort.looks, effort.pairs)
    attitudes = look(camera, looks, request.seed, request.envelope)
    pairs = pairs_in_view(stars.icrs[:grid_rows], attitudes, camera.shape)
    used_stars = pairs.brighter_than(rows)
    counted = counted_pairs(used_stars, attitudes)
    if effort.pointings:
        counted = _count(request, stars.icrs[:rows], effort, each, _part(progress, 0.0, 0.6))
    curves = curves_of(
        camera, stars, limits.in_force_mag, attitudes, pairs, used_stars, effort.pairs, _part(progress, 0.6, 0.85)
    )
    single_stage, double_stage, problem = _baffles(request)
    trade: tuple[TradeRow, ...] = ()
    if effort.trade_looks:
        trade_attitudes = attitudes[: effort.trade_looks]
        trade = lens_trade(camera, stars, trade_attitudes, effort.pairs / 4, _part(progress, 0.85, 1.0))
    accuracies = accuracy(camera, stars, used_stars)
    blur, psf = motion_blur(camera), psf_advice(camera)
    notes = _notes(request, limits, counted)
    longest = longest_exposure_s(camera)
    return DesignReport(
        request,
        effort,
        limits,
        counted,
        looks,
        curves,
        accuracies,
        blur,
        psf,
        longest,
        single_stage,
        double_stage,
        problem,
        trade,
        notes,
    )


def camera_row(camera: DesignCamera, stars: StarTable, looks: int, pairs: float, seed: int = 1) -> TradeRow:
    """Return the row of a camera in the table of cameras, for pointings over the whole sky."""
    return trade_row(camera, stars, look(camera, looks, seed), pairs)


def _count(request: DesignRequest, unit: Array, effort: DesignEffort, each: Each, progress: Progress) -> InView:
    camera = request.camera
    pointings = affordable(camera, len(unit), effort.pointings, effort.pairs * MAX_COUNTED)

    def portion(k: int, m: int) -> Array:
        # This seed differs from the seeds of all portions and curves for any size of a portion.
        where = request.seed * 1_000_003 + 1 + k
        return look(camera, m, where, request.envelope)

    return count_stars(unit, portion, pointings, camera.shape, each, progress)


def _baffles(request: DesignRequest) -> tuple[BaffleGeometry | None, BaffleGeometry | None, str]:
    camera = request.camera
    radius = camera.pupil_mm / 2
    try:
        single_stage = one_stage(radius, camera.half_diagonal_rad, request.exclusion_rad, request.spare_mm)
    except BadInput as error:
        return None, None, str(error)
    try:
        return single_stage, two_stage(radius, camera.half_diagonal_rad, request.exclusion_rad), ""
    except BadInput as error:
        return single_stage, None, str(error)


def _check(limits: MagnitudeLimits, stars: StarTable) -> None:
    brightest = float(stars.v_mag[0])
    if limits.in_force_mag < brightest:
        raise BadInput(
            "this camera detects no star",
            expected=f"a limit fainter than V {brightest:.2f}, the brightest star",
            got=f"V {limits.in_force_mag:.2f}",
            hint="use a longer exposure, a faster lens, or less noise",
        )


def _notes(request: DesignRequest, limits: MagnitudeLimits, counted: InView) -> tuple[str, ...]:
    camera, notes = request.camera, []
    if limits.in_force_mag > COMPLETE_V_MAG:
        notes.append(
            f"The limit V {limits.in_force_mag:.2f} is beyond V {COMPLETE_V_MAG}, above which Hipparcos is incomplete: star "
            "counts are lower bounds, accuracies are upper bounds."
        )
    if limits.saturation_mag > limits.in_force_mag:
        notes.append("Every detected star saturates: the exposure is too long or the converter too small.")
    if camera.mag_limit is not None and camera.mag_limit > limits.brightest_pixel_mag + 0.005:
        notes.append(
            f"The magnitude limit V {camera.mag_limit:.2f} is fainter than the radiometry allows "
            f"(V {limits.brightest_pixel_mag:.2f} at SNR {camera.threshold_snr:g})."
        )
    if counted.p_fewer_than(3) > 0.01:
        notes.append(
            "More than one field in a hundred has fewer than three stars, with which no matching method works."
        )
    return tuple(notes)


def _part(progress: Progress, low: float, high: float) -> Progress:
    return lambda share: progress(low + (high - low) * share)
