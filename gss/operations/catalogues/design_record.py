"""Design report as plain values. Each number has its unit and source. Angles are in degrees and arcseconds because the values
are only displayed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from gss.catalogue_tools.design.accuracy import Accuracy
from gss.catalogue_tools.design.baffle import BaffleGeometry
from gss.catalogue_tools.design.camera import LIMITS, DesignCamera
from gss.catalogue_tools.design.design_report import DesignReport
from gss.catalogue_tools.design.limits_erlank import equal_circle_rad
from gss.catalogue_tools.design.papers import PaperValue, values_for
from gss.catalogue_tools.design.radiometry import brightest_pixel_share, energy_window
from gss.catalogue_tools.design.stray_light import (
    EARTH,
    MOON,
    SUN,
    effective_area_cm2,
    imaged_e_s,
    pixel_etendue_cm2_sr,
    stray_e_s,
)
from gss.catalogue_tools.design.trade import TradeRow
from gss.domain.angles import ARCSEC_RAD
from gss.operations.catalogues.design_curves import curve_values, short
from gss.operations.catalogues.design_values import (
    BaffleValues,
    CameraValues,
    DesignValues,
    FieldLimit,
    FigureValue,
    TradeValues,
)

OURS = "GSS radiometry"
STRAY_BEYOND_DEG = (0.0, 1.0, 7.0, 17.0, 38.0)
"""Angles of the Sun beyond the exclusion angle of the shade, as in the rows of Moniteq 1983 Table 5.3."""


def record_of(
    report: DesignReport, base: DesignCamera, cameras: tuple[TradeRow, ...], elapsed_ms: float
) -> DesignValues:
    """Return all values of a design page. ``elapsed_ms``: duration of the calculation."""
    camera, in_view = report.request.camera, report.in_view
    papers = values_for(base.name)
    return {
        "profile": base.name,
        "camera": camera_of(camera),
        "base": camera_of(base),
        "changed": [name for name in camera.fields_different_from(base) if name != "name"],
        "sky": "whole sky" if report.request.envelope is None else "along the orbit",
        "figures": [_with_paper(f, papers) for f in _figures(report)],
        "histogram": {
            "pointings": in_view.pointings,
            "counts": [int(n) for n in in_view.histogram],
            "mean": in_view.mean,
            "p_fewer_than_3": in_view.p_fewer_than(3),
            "p_fewer_than_5": in_view.p_fewer_than(5),
            "worst_stars": in_view.worst_stars,
            "worst_ra_deg": math.degrees(in_view.worst_ra_rad),
            "worst_dec_deg": math.degrees(in_view.worst_dec_rad),
        },
        # The published values are valid only for the field of view of the documented camera.
        "curves": curve_values(report, papers if camera.fov_rad == base.fov_rad else ()),
        "baffles": [_baffle(b) for b in (report.one_stage, report.two_stage) if b is not None],
        "baffle_problem": report.baffle_problem,
        "trade": [row_of(r) for r in report.trade],
        "cameras": [row_of(r) for r in cameras],
        "notes": list(report.notes),
        "looks": report.looks,
        "full": report.effort.pointings > 0,
        "elapsed_ms": short(elapsed_ms),
    }


def camera_of(camera: DesignCamera) -> CameraValues:
    """Return the values of a camera by field name. The names contain the units."""
    return {f.name: getattr(camera, f.name) for f in fields(camera)}


def field_limits() -> dict[str, FieldLimit]:
    """Return minimum, maximum and unit of each editable field."""
    return {name: {"min": low, "max": high, "unit": unit} for name, (low, high, unit) in LIMITS.items()}


def _figures(report: DesignReport) -> list[FigureValue]:
    return [*_optics(report), *_light(report), *_sky(report), *_accuracy(report), *_moving(report), *_shade(report)]


def _figure(group: str, key: str, label: str, value: float, unit: str, source: str) -> FigureValue:
    finite = value is not None and math.isfinite(value)
    return {
        "group": group,
        "key": key,
        "label": label,
        "value": short(value) if finite else None,
        "unit": unit,
        "source": source,
        "paper": None,
        "paper_source": "",
    }


def _with_paper(figure: FigureValue, papers: Sequence[PaperValue]) -> FigureValue:
    for paper in papers:
        if paper.figure == figure["key"] and math.isnan(paper.x):
            return figure | {"paper": paper.value, "paper_source": paper.source}
    return figure


def _optics(report: DesignReport) -> list[FigureValue]:
    camera, group = report.request.camera, "Field and lens"
    across, down = camera.fov_rad
    circle = equal_circle_rad(across, down)
    return [
        _figure(
            group, "fov_col_deg", "field across columns", math.degrees(across), "°", "Erlank 2013 eq. 3.5.2, with ½"
        ),
        _figure(group, "fov_row_deg", "field across rows", math.degrees(down), "°", "Erlank 2013 eq. 3.5.3, with ½"),
        _figure(
            group,
            "fov_diagonal_deg",
            "field diagonal",
            2 * math.degrees(camera.half_diagonal_rad),
            "°",
            "Jacobs 1995 eq. 7.23",
        ),
        _figure(
            group,
            "fov_circle_deg",
            "circle of equal area, as if flat",
            math.degrees(circle),
            "°",
            "Erlank 2013 eq. 3.5.4",
        ),
        _figure(group, "pixel_arcsec", "pixel", camera.camera.pixel_rad / ARCSEC_RAD, "″", "pitch over focal length"),
        _figure(group, "pupil_mm", "entrance pupil", camera.pupil_mm, "mm", "Jacobs 1995 eq. 9.2"),
        _figure(group, "aperture_cm2", "area of the pupil", camera.aperture_cm2, "cm²", "Jacobs 1995 eq. 9.5"),
    ]


def _light(report: DesignReport) -> list[FigureValue]:
    camera, limits, group = report.request.camera, report.limits, "Light"
    side, share = energy_window(camera.psf_sigma_px)
    peak = 100 * brightest_pixel_share(camera.psf_sigma_px)
    in_force = OURS if camera.mag_limit is None else "given"
    return [
        _figure(
            group,
            "zero_point_e_s",
            "electrons from V 0",
            camera.zero_point_e_s,
            "e/s",
            "Erlank 2013 eq. 3.4.2 × efficiency",
        ),
        _figure(group, "noise_e", "noise of a dark pixel", camera.noise_e, "e", "Huffman 2006 §3.2"),
        _figure(group, "peak_share", "light in the brightest pixel", peak, "%", "Gaussian star, mean over the pixel"),
        _figure(group, "window_px", f"best window, {100 * share:.0f} % of the light", side, "px", OURS),
        _figure(group, "limit_mag", "limiting magnitude in force", limits.in_force_mag, "V", in_force),
        _figure(
            group,
            "limit_peak_mag",
            "limit, brightest pixel",
            limits.brightest_pixel_mag,
            "V",
            f"{OURS}; Huffman 2006 eq. 3.17",
        ),
        _figure(group, "limit_window_mag", "limit, energy in the window", limits.window_mag, "V", OURS),
        _figure(
            group, "limit_jacobs_mag", "limit, edge pixel over dark pattern", limits.jacobs_mag, "V", "Jacobs 1995 §9.2"
        ),
        _figure(group, "limit_huffman_mag", "limit, peak over noise", limits.huffman_mag, "V", "Huffman 2006 eq. 3.18"),
        _figure(group, "limit_erlank_mag", "limit, photons for SNR 10", limits.erlank_mag, "V", "Erlank 2013 §3.4.4"),
        _figure(group, "limit_moniteq_mag", "limit, 3 × 3 window", limits.moniteq_mag, "V", "Moniteq 1983 §4.4"),
        _figure(
            group, "saturation_mag", "saturates, brighter than", limits.saturation_mag, "V", "full well or converter"
        ),
        _figure(
            group,
            "longest_exposure_s",
            "dark current fills a pixel in",
            report.longest_exposure_s,
            "s",
            "Erlank 2013 §3.4.4",
        ),
        _figure(
            group,
            "best_psf_px",
            "best σ of the star image",
            report.psf.best_px,
            "px",
            "bound and pixel bias, Moniteq 1983 §4.2",
        ),
    ]


def _sky(report: DesignReport) -> list[FigureValue]:
    in_view, group = report.in_view, "Stars in view"
    source = f"Hipparcos, {in_view.pointings} pointings (Jacobs 1995 §5.1)"
    return [
        _figure(group, "stars_mean", "mean", in_view.mean, "stars", source),
        _figure(group, "p_fewer_3", "fewer than 3", 100 * in_view.p_fewer_than(3), "%", source),
        _figure(group, "p_fewer_5", "fewer than 5", 100 * in_view.p_fewer_than(5), "%", source),
        _figure(group, "stars_least", "fewest found", in_view.worst_stars, "stars", source),
    ]


def _accuracy(report: DesignReport) -> list[FigureValue]:
    accuracy: Accuracy = report.accuracy
    group, source = "Accuracy of the attitude, 1σ", f"Cramér–Rao bound, {report.looks} pointings"

    def one(key: str, label: str, value_rad: float) -> FigureValue:
        return _figure(group, f"{key}_arcsec", label, value_rad / ARCSEC_RAD, "″", source)

    return [
        one("cross_median", "across, median", accuracy.cross_median_rad),
        one("cross_mean", "across, mean", accuracy.cross_mean_rad),
        one("cross_p95", "across, 95 % better", accuracy.cross_p95_rad),
        one("cross_worst", "across, worst", accuracy.cross_worst_rad),
        one("roll_median", "roll, median", accuracy.roll_median_rad),
        one("roll_mean", "roll, mean", accuracy.roll_mean_rad),
        one("roll_p95", "roll, 95 % better", accuracy.roll_p95_rad),
        one("roll_worst", "roll, worst", accuracy.roll_worst_rad),
        _figure(group, "share_three", "fields with at least 3 stars", 100 * accuracy.share, "%", source),
    ]


def _moving(report: DesignReport) -> list[FigureValue]:
    blur, group = report.blur, "Motion"
    return [
        _figure(
            group,
            "blur_rate_deg_s",
            "half a magnitude lost at",
            math.degrees(blur.rate_rad_s),
            "°/s",
            "streaked Gaussian",
        ),
        _figure(group, "blur_streak_px", "streak then", blur.streak_px, "px", "streaked Gaussian"),
        _figure(
            group,
            "smear_rate_deg_s",
            "0.88 px smear at",
            math.degrees(blur.smear_limit_rate_rad_s),
            "°/s",
            "Moniteq 1983 §4.2",
        ),
    ]


def _shade(report: DesignReport) -> list[FigureValue]:
    camera, group = report.request.camera, "Baffle and stray light"
    etendue = pixel_etendue_cm2_sr(camera.pitch_col_um, camera.pitch_row_um, camera.f_number)
    result = [
        _figure(
            group,
            "exclusion_deg",
            "sources kept out from",
            math.degrees(report.request.exclusion_rad),
            "°",
            "requested",
        )
    ]
    if report.one_stage is not None:
        baffle, source = report.one_stage, "Jacobs 1995 §7.6"
        result += [
            _figure(group, "one_length_mm", "one stage, length", baffle.length_mm, "mm", source),
            _figure(group, "one_diameter_mm", "one stage, diameter", baffle.outer_diameter_mm, "mm", source),
            _figure(group, "one_vanes", "one stage, knife edges", len(baffle.edge_mm), "", source),
        ]
    if report.two_stage is not None:
        two, source = report.two_stage, "Moniteq 1983 §5.2"
        result += [
            _figure(group, "two_length_mm", "two stages, length", two.length_mm, "mm", source),
            _figure(group, "two_inner_mm", "two stages, inner stage", two.wall_mm[0][1], "mm", source),
            _figure(group, "two_diameter_mm", "two stages, diameter", two.outer_diameter_mm, "mm", source),
        ]
    for body in (SUN, EARTH, MOON):
        key = f"{body.name.lower()}_e_s"
        # The document assumes that light enters the lens without loss.
        result.append(
            _figure(group, key, f"{body.name} in the field", imaged_e_s(body, etendue), "e/s", "Moniteq 1983 Table 5.2")
        )
    # The table is for 20 µm pixels behind f/1.4. Light that passes the baffle is spread over the whole field, so the
    # light on a pixel is proportional to the etendue of the pixel.
    share = etendue / pixel_etendue_cm2_sr(20, 20, 1.4)
    for beyond_deg in STRAY_BEYOND_DEG:
        area_cm2 = effective_area_cm2(
            report.request.exclusion_rad + math.radians(beyond_deg), report.request.exclusion_rad
        )
        stray = share * stray_e_s(SUN, area_cm2)
        title = f"Sun {beyond_deg:g}° outside the excluded angle"
        result.append(_figure(group, f"sun_stray_{beyond_deg:g}_e_s", title, stray, "e/s", "Moniteq 1983 Table 5.3"))
    return result


def _baffle(baffle: BaffleGeometry) -> BaffleValues:
    return {
        "kind": baffle.kind,
        "lens_radius_mm": baffle.lens_radius_mm,
        "half_fov_deg": math.degrees(baffle.half_fov_rad),
        "exclusion_deg": math.degrees(baffle.exclusion_rad),
        "length_mm": baffle.length_mm,
        "front_radius_mm": baffle.front_radius_mm,
        "edges_mm": [list(e) for e in baffle.edge_mm],
        "walls_mm": [list(w) for w in baffle.wall_mm],
    }


def row_of(row: TradeRow) -> TradeValues:
    """Return a row of the table of cameras as plain values."""
    camera = row.camera
    across, down = camera.fov_rad
    return {
        "name": camera.name,
        "focal_mm": camera.focal_mm,
        "f_number": camera.f_number,
        "pupil_mm": camera.pupil_mm,
        "fov_deg": [math.degrees(across), math.degrees(down)],
        "pixel_arcsec": camera.camera.pixel_rad / ARCSEC_RAD,
        "limit_mag": row.limit_mag,
        "saturation_mag": number(row.saturation_mag),
        "stars": row.stars,
        "p_fewer_3": row.p_fewer_3,
        "pointings": row.pointings,
        "cross_arcsec": number(row.cross_rad / ARCSEC_RAD),
        "roll_arcsec": number(row.roll_rad / ARCSEC_RAD),
        "blur_rate_deg_s": float(np.degrees(row.blur_rate_rad_s)),
    }


def number(value: float) -> float | None:
    """Return a rounded number, None if it is not finite, because JSON has no NaN."""
    return short(value) if math.isfinite(value) else None
