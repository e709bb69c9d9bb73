"""Curves of a design report as plain values, with labels, units and the points published in the documents."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from gss.catalogue_tools.design.curves import NEED
from gss.catalogue_tools.design.design_report import DesignReport
from gss.catalogue_tools.design.papers import PaperValue
from gss.domain.angles import ARCSEC_RAD, Array
from gss.operations.catalogues.design_values import CurveValues, LineValues, MarkValue, UprightValue

SHARE = "share of fields, %"


def curve_values(report: DesignReport, papers: Sequence[PaperValue]) -> list[CurveValues]:
    """Return all curves, in the order of the page."""
    camera, curves = report.request.camera, report.curves
    limit = _upright("limit", report.limits.in_force_mag)
    by_limit = [
        _line(f"fewer than {n}", curves.limit_mag, 100 * p) for n, p in zip(NEED, curves.p_fewer_by_limit, strict=True)
    ]
    circles = np.degrees(curves.circle_rad)
    by_circle = [
        _line(f"fewer than {n}", circles, 100 * p) for n, p in zip(NEED, curves.p_fewer_in_circle, strict=True)
    ]
    by_focal = [
        _line(f"fewer than {n}", curves.focal_mm, 100 * p) for n, p in zip(NEED, curves.p_fewer_by_focal, strict=True)
    ]
    cross, roll = (
        [getattr(a, f"{axis}_median_rad") / ARCSEC_RAD for a in curves.by_exposure] for axis in ("cross", "roll")
    )
    cross_v, roll_v = (
        [getattr(a, f"{axis}_median_rad") / ARCSEC_RAD for a in curves.by_limit] for axis in ("cross", "roll")
    )
    across, down = camera.fov_rad
    circle = math.degrees(2 * camera.shape.equal_circle_rad)
    exposure = _upright("exposure", camera.exposure_s)
    return [
        _curve(
            "p_by_limit",
            "Too few stars, by limit",
            "limiting magnitude V",
            SHARE,
            by_limit,
            [limit],
            _points(papers),
            log_y=True,
        ),
        _curve(
            "mean_by_limit",
            "Stars in the field",
            "limiting magnitude V",
            "stars, mean",
            [_line("mean", curves.limit_mag, curves.mean_stars)],
            [limit],
            log_y=True,
        ),
        _curve(
            "p_by_circle",
            "Too few stars, by circular field",
            "diameter of the field, °",
            SHARE,
            by_circle,
            [_upright("equal circle on the sky", circle)],
            log_y=True,
        ),
        _curve(
            "p_by_focal",
            f"Too few stars, by focal length, at V {report.limits.in_force_mag:.1f}",
            "focal length, mm",
            SHARE,
            by_focal,
            [_upright(f"{math.degrees(across):.1f}° × {math.degrees(down):.1f}°,", camera.focal_mm)],
            log_y=True,
        ),
        _curve(
            "snr",
            "Signal to noise",
            "magnitude V",
            "SNR",
            [
                _line("brightest pixel", curves.v_mag, curves.snr_brightest),
                _line("best window", curves.v_mag, curves.snr_window),
                _line("threshold", curves.v_mag[[0, -1]], np.full(2, camera.threshold_snr)),
            ],
            [_upright("saturates", report.limits.saturation_mag), limit],
            log_y=True,
        ),
        _curve(
            "centroid",
            "Centroid error of one star, bound",
            "magnitude V",
            "px, 1σ",
            [_line("one axis", curves.v_mag, curves.centroid_px)],
            [limit],
            log_y=True,
        ),
        _curve(
            "nea",
            "Noise equivalent angle at rest",
            "exposure, s",
            "″, 1σ, median",
            [_line("across", curves.exposure_s, cross), _line("roll", curves.exposure_s, roll)],
            [exposure],
            log_x=True,
            log_y=True,
        ),
        _curve(
            "accuracy_by_limit",
            "Accuracy with stars to a limit",
            "limiting magnitude V",
            "″, 1σ, median",
            [_line("across", curves.used_limit_mag, cross_v), _line("roll", curves.used_limit_mag, roll_v)],
            log_y=True,
        ),
        _curve(
            "limit_by_exposure",
            "Limiting magnitude by exposure",
            "exposure, s",
            "V",
            [_line("limit", curves.exposure_s, curves.exposure_limit_mag)],
            [exposure],
            log_x=True,
        ),
        _curve(
            "psf_limit",
            "Limit by size of the star image",
            "σ, px",
            "V",
            [
                _line("brightest pixel", report.psf.sigma_px, report.psf.limit_brightest_mag),
                _line("best window", report.psf.sigma_px, report.psf.limit_window_mag),
            ],
            [_upright("now", camera.psf_sigma_px)],
            log_x=True,
        ),
        _curve(
            "psf_centroid",
            "Centroid of the faintest star by its size",
            "σ, px",
            "px, 1σ",
            [_line("noise and pixel bias", report.psf.sigma_px, report.psf.centroid_px)],
            [_upright("now", camera.psf_sigma_px), _upright("best", report.psf.best_px)],
            log_x=True,
            log_y=True,
        ),
    ]


def _points(papers: Sequence[PaperValue]) -> list[MarkValue]:
    """Return the published values that depend on the magnitude limit, as points of the curve."""
    labels = {f"p_fewer_{n}_by_limit": f"fewer than {n}" for n in NEED}
    return [
        {"x": p.x, "y": 100 * p.value, "label": labels[p.figure], "source": p.source}
        for p in papers
        if p.figure in labels
    ]


def _curve(
    key: str,
    title: str,
    x_label: str,
    y_label: str,
    lines: list[LineValues],
    uprights: Iterable[UprightValue | None] = (),
    marks: Iterable[MarkValue] = (),
    log_x: bool = False,
    log_y: bool = False,
) -> CurveValues:
    return {
        "key": key,
        "title": title,
        "x_label": x_label,
        "y_label": y_label,
        "log_x": log_x,
        "log_y": log_y,
        "lines": lines,
        "uprights": [u for u in uprights if u is not None],
        "marks": list(marks),
    }


def _line(label: str, x: Array | Sequence[float], y: Array | Sequence[float]) -> LineValues:
    """Return the points of a line. NaN and infinite values become gaps."""
    return {
        "label": label,
        "x": [short(v) for v in x],
        "y": [short(v) if math.isfinite(v) else None for v in y],
    }


def _upright(label: str, x: float) -> UprightValue | None:
    return {"label": label, "x": float(x)} if math.isfinite(x) else None


def short(value: float) -> float:
    """Return the value rounded to six digits, which exceeds the accuracy of all values."""
    return float(f"{float(value):.6g}")
