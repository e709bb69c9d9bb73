"""Performance sheet of a camera on paper: the rows that follow from its design. The other rows state what they need."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import datetime

import numpy as np

from gss.catalogue_tools.design.accuracy import MIN_STARS, sigma_rad, star_sigma_px
from gss.catalogue_tools.design.camera import LIMITS, DesignCamera
from gss.catalogue_tools.design.centroid_bound import pixel_bias_px
from gss.catalogue_tools.design.design_report import QUICK, DesignRequest
from gss.catalogue_tools.design.in_view import affordable, bright_rows, look, pairs_in_view
from gss.catalogue_tools.design.radiometry import limit_mag, motion_blur
from gss.domain.angles import Array
from gss.domain.stars import StarTable
from gss.operations.catalogues.design import DesignQuestion, request_of
from gss.operations.report.html import as_html
from gss.operations.report.pdf import as_pdf
from gss.operations.studies.analyse import AnalysisResult
from gss.operations.studies.sheet_record import SheetSource, as_sheet_record, sheet_report
from gss.operations.studies.sheet_simulation import AGED
from gss.pipeline.sheet.rows import SheetFigure, SheetRow, interval, missing, share_figure
from gss.pipeline.sheet.sheet import ABERRATION, BIAS, DATE, FIELD, NOISE, PIXEL, THERMAL, PerformanceSheet
from gss.pipeline.sheet.trials import ACQUISITION, END_OF_LIFE, ROBUSTNESS, TRACKING

NO_BOUND = float("nan")
BOUND = "Cramér–Rao bound of the stars in the field (Winick 1986), combined by Fisher information"
SIMULATE = "rendered frames: gss sheet --simulate computes this row for an instrument package"


def sheet_of_design(question: DesignQuestion, base: DesignCamera, stars: StarTable) -> AnalysisResult:
    """Return the performance sheet of a design. ``stars``: brightest first. Raises BadInput if the camera is not
    valid."""
    request = request_of(question, base)
    changed = ", ".join(f"{name} {value:g}" for name, value in question.changes.items()) or "as in the document"
    noise, acquisition = _noise_and_acquisition(request, stars)
    rows = (
        missing(*BIAS, "a unit: a design has no misalignment"),
        missing(*THERMAL, "a unit with its temperatures, or a mechanical model"),
        missing(*FIELD, "a lens with its calibration: the lens of a design has no distortion"),
        _pixel(request.camera),
        noise,
        missing(*ABERRATION, "a unit: a design does not correct the aberration"),
        missing(*DATE, "a unit with its clock"),
        acquisition,
        _tracking(request.camera),
        _end_of_life(request, stars),
        missing(*ROBUSTNESS, SIMULATE),
    )
    sheet = PerformanceSheet(rows)
    subject = f"design of {base.name}, {changed}; seed {request.seed}"
    source = SheetSource(base.name, f"{base.name} (design)", "", "design", subject, request.seed)
    return AnalysisResult("sheet", sheet_report(sheet, source, request.camera.camera), as_sheet_record(sheet, source))


def sheet_file(sheet: AnalysisResult, kind: str, created: datetime) -> bytes:
    """Return a sheet as a file. ``kind``: json, html or pdf."""
    if kind == "html":
        return as_html(sheet.report).encode()
    if kind == "pdf":
        return as_pdf(sheet.report, created)
    return json.dumps(sheet.figures, indent=1, ensure_ascii=False, allow_nan=False).encode()


def _fields(request: DesignRequest, stars: StarTable) -> tuple[Array, Array, Array]:
    """Return the (m,) numbers of detected stars and the (m,) standard deviations across and about the boresight of m
    pointings; NaN for fields with fewer than three stars."""
    camera = request.camera
    rows = bright_rows(stars, limit_mag(camera))
    if not rows:
        return np.zeros(QUICK.looks, np.intp), np.full(QUICK.looks, np.nan), np.full(QUICK.looks, np.nan)
    pointings = affordable(camera, rows, QUICK.looks, QUICK.pairs)
    attitudes = look(camera, pointings, request.seed, request.envelope)
    pairs = pairs_in_view(stars.icrs[:rows], attitudes, camera.shape)
    across, about = sigma_rad(camera, pairs, star_sigma_px(camera, stars, rows))
    return np.asarray(pairs.count), across, about


def _noise_and_acquisition(request: DesignRequest, stars: StarTable) -> tuple[SheetRow, SheetRow]:
    counts, across, about = _fields(request, stars)
    where = "pointings uniform over the sky" if request.envelope is None else "pointings along the orbit"
    solved = np.isfinite(across)
    noise = missing(*NOISE, f"fields with at least {MIN_STARS} stars")
    if solved.any():
        figures = (_spread("x, y (rms of both)", across[solved]), _spread("z", about[solved]))
        text = f"at rest; median, and interval of 95 % of the {where}; without errors of lens, pixels and catalogue"
        noise = SheetRow(NOISE[0], NOISE[1], f"{BOUND}; 1 σ", text, int(solved.sum()), figures)
    acquisition = SheetRow(
        ACQUISITION[0],
        ACQUISITION[1],
        "stars brighter than the limit in each field; Wilson intervals",
        f"{where}; enough stars are necessary, but the matching of a chain is not computed",
        len(counts),
        tuple(_share_with(counts, n) for n in (MIN_STARS, 5)),
    )
    return noise, acquisition


def _spread(name: str, values_rad: Array) -> SheetFigure:
    """Return the median of the pointings with the interval that contains 95 % of them."""
    low, high = interval(values_rad)
    return SheetFigure(name, float(np.median(values_rad)), float(low), float(high), "rad")


def _share_with(counts: Array, stars: int) -> SheetFigure:
    return share_figure(f"at least {stars} stars", int(np.count_nonzero(counts >= stars)), len(counts))


def _pixel(camera: DesignCamera) -> SheetRow:
    """Return the row of the error within a pixel: the error of a centre of light that is not corrected."""
    bias_px = round(float(pixel_bias_px(camera.psf_sigma_px)), 6)
    return SheetRow(
        PIXEL[0],
        PIXEL[1],
        "interpolation error of an uncorrected centre of light, rms over the pixel (Moniteq 1983 eq. 4.6)",
        f"Gaussian star of σ {camera.psf_sigma_px:g} px; the fixed pattern needs a detector; a chain can correct this error",
        0,
        (SheetFigure("one star, periodic", bias_px, NO_BOUND, NO_BOUND, "px"),),
    )


def _tracking(camera: DesignCamera) -> SheetRow:
    rate = float(motion_blur(camera).rate_rad_s)
    return SheetRow(
        TRACKING[0],
        TRACKING[1],
        "smear of a Gaussian star during the exposure",
        "the loss of an attitude needs rendered or real sequences",
        0,
        (SheetFigure("rate that costs half a magnitude", rate, NO_BOUND, NO_BOUND, "rad/s"),),
    )


def _end_of_life(request: DesignRequest, stars: StarTable) -> SheetRow:
    """Return the row of the aged camera: fields with enough stars, and noise. Hot pixels need rendered frames."""
    figures: list[SheetFigure] = []
    pointings = 0
    for title, dark, light, hot in AGED:
        if hot:
            continue
        camera = request.camera
        dark_e_s = min(camera.dark_current_e_s * dark, LIMITS["dark_current_e_s"][1])
        aged = camera.edited(dark_current_e_s=dark_e_s, transmission=camera.transmission * light)
        counts, across, _ = _fields(replace(request, camera=aged), stars)
        pointings += len(counts)
        share = _share_with(counts, MIN_STARS)
        figures.append(replace(share, name=f"{title}: {share.name}"))
        solved = across[np.isfinite(across)]
        if len(solved):
            figures.append(_spread(f"{title}: noise across", solved))
    return SheetRow(
        END_OF_LIFE[0],
        END_OF_LIFE[1],
        f"{BOUND}, with an aged detector and lens",
        "the ageing is assumed, not the result of a radiation analysis; hot pixels need rendered frames",
        pointings,
        tuple(figures),
    )
