"""Reports of analyses: values in arcseconds and degrees, plots over time, histograms, maps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.operations.report.figures import number
from gss.operations.report.parts import Arrows, Cells, Fact, Level, Plot, Report, Section, Series, Table
from gss.operations.studies.sheet_pieces import (
    PHASES,
    axes_table,
    bars,
    finite,
    maybe,
    notes,
    numbers,
    over_time,
    phase_means,
    rms,
)
from gss.pipeline.analysis.integration import NeaCurve
from gss.pipeline.analysis.sensitivity import Sensitivity
from gss.pipeline.analysis.series import AttitudeSeries
from gss.pipeline.analysis.slew import SlewTest
from gss.pipeline.analysis.steady import SteadyTest
from gss.pipeline.analysis.telemetry import TelemetryFigures
from gss.pipeline.analysis.two_cameras import Consistency
from gss.pipeline.calibration.plain_values import as_record
from gss.pipeline.calibration.residual_figures import residual_map

ERLANK_DEG = {"RA · cos Dec": (0.0051, 0.0154), "Dec": (0.0072, 0.0215), "rotation": (0.0203, 0.0608)}
"""1σ and 3σ of the original test, Erlank 2013 Table 6.1."""
TITLES = {"earth-fixed": "Earth-fixed test", "celestial-fixed": "Celestial-fixed test"}


def steady(kind: str, result: SteadyTest, series: AttitudeSeries, subject: str) -> Report:
    """Return the report of an Earth-fixed or celestial-fixed test."""
    expected = float(np.linalg.norm(result.expected_icrs_rad_s))
    speed = float(np.linalg.norm(result.rate_icrs_rad_s))
    facts = [
        Fact("frames with an attitude", f"{result.solved} of {result.frames}"),
        Fact("span", number(result.span_s), "s"),
        Fact("camera rotation", number(speed / ARCSEC_RAD), "″/s", f"expected {number(expected / ARCSEC_RAD)}"),
        Fact("excluded outliers", number(int(result.strays.sum()))),
    ]
    pole = np.degrees(np.arccos(np.clip(result.rate_icrs_rad_s[2] / max(speed, 1e-300), -1, 1)))
    if expected:
        facts.append(Fact("angle between rotation axis and pole", number(float(pole), 3), "°"))
    times_s = series.times_s
    deviation = result.deviation_rad / ARCSEC_RAD
    sections = [
        Section(
            "Steadiness",
            "A constant rotation is fitted; the residual is the sensor's error.",
            facts,
            [],
            [axes_table(result.body)],
        ),
        Section("As right ascension, declination, rotation", "", [], [], [axes_table(result.sky, ERLANK_DEG)]),
        Section(
            "Over time",
            "",
            [],
            [
                over_time("Deviation across the boresight", times_s, deviation[:, :2], ("x", "y"), "arcsec"),
                over_time("Deviation about the boresight", times_s, deviation[:, 2:], ("about",), "arcsec"),
                over_time(
                    "Stars", times_s, np.column_stack([series.centroids, series.matches]), ("found", "matched"), "stars"
                ),
            ],
        ),
        Section("Distribution", "", [], [bars(a.name, deviation[:, k]) for k, a in enumerate(result.body)]),
    ]
    return Report(TITLES[kind], subject, sections, notes(result.warnings))


def slew(result: SlewTest, series: AttitudeSeries, subject: str) -> Report:
    """Return the report of a slew test, which compares the measured rates with the commanded rate."""
    degree = np.degrees
    uncertain = number(float(degree(result.mean_sigma_rad_s)), 2)
    facts = [
        Fact("commanded", number(float(degree(result.commanded_rad_s)), 5), "°/s"),
        Fact(
            "measured",
            number(float(degree(result.mean_speed_rad_s)), 6),
            "°/s",
            f"±{uncertain}",
        ),
        Fact("measured ÷ commanded", number(result.ratio, 5)),
        Fact(
            "scatter along the rotation", number(float(result.sigma_rad_s[0] / ARCSEC_RAD)), "″/s", "1σ of one interval"
        ),
        Fact(
            "scatter across the rotation",
            number(float(np.hypot(*result.sigma_rad_s[1:]) / np.sqrt(2) / ARCSEC_RAD)),
            "″/s",
        ),
        Fact("σ from the chain's covariances", number(result.claimed_rad_s / ARCSEC_RAD), "″/s", "mean of the axes"),
        Fact("frames with an attitude", number(100 * result.solved_share, 4), "%"),
        Fact("stars matched", number(result.mean_matches, 3), "", "mean"),
        Fact("rotation axis", ", ".join(number(float(a), 3) for a in result.axis), "", "camera x, y, z"),
    ]
    speed = [float(v) for v in degree(result.speed_rad_s)]
    plot = Plot(
        "Rate from frame to frame",
        "UTC",
        "°/s",
        [Series("rate", numbers(result.times_s), list(speed), "dots")],
        [Level(float(degree(result.commanded_rad_s)), "commanded")],
        time=True,
    )
    stars = over_time(
        "Stars", series.times_s, np.column_stack([series.centroids, series.matches]), ("found", "matched"), "stars"
    )
    return Report("Slew test", subject, [Section("Rate", "", facts, [plot, stars])], notes(result.warnings))


def sensitivity(result: Sensitivity, profile: CameraProfile, subject: str) -> Report:
    """Return the report of the detection limit."""
    profile_limit = profile.sensor.faint_limit_mag
    limit, levels = Fact("50 % of the stars detected at", "not determined"), [Level(profile_limit, "profile", True)]
    if np.isfinite(result.mag_50):
        limit = replace(limit, value=number(result.mag_50, 3), unit="V", note=f"±{number(result.sigma_50, 2)}")
        levels.append(Level(result.mag_50, "50 %", True))
    facts = [
        limit,
        Fact("90 % detected at", number(finite(result.mag_90), 3), "V"),
        Fact("profile value", number(profile_limit, 3), "V"),
        Fact("bright stars detected", number(100 * result.ceiling, 3), "%"),
        Fact("stars expected", number(int(result.stars.sum()))),
    ]
    share = [float(f / n) if n else None for f, n in zip(result.found, result.stars, strict=True)]
    middles = numbers((result.edges_mag[1:] + result.edges_mag[:-1]) / 2)
    curve = Plot(
        "Share of catalogue stars detected",
        "V magnitude",
        "share",
        [
            Series("found", middles, share, "line"),
            Series("95 % low", middles, maybe(result.low), "dots"),
            Series("95 % high", middles, maybe(result.high), "dots"),
        ],
        levels,
    )
    rows = [
        [f"{lo:.2f} – {hi:.2f}", str(int(n)), str(int(f)), number(100 * f / n, 3) if n else "–"]
        for lo, hi, n, f in zip(result.edges_mag, result.edges_mag[1:], result.stars, result.found, strict=False)
    ]
    table = Table("By magnitude", ["V", "stars", "found", "%"], rows)
    return Report("Sensitivity", subject, [Section("Limit", "", facts, [curve], [table])], notes(result.warnings))


def nea(curve: NeaCurve, subject: str) -> Report:
    """Return the report of the noise equivalent angle as a function of the integration time."""
    facts = [Fact("exponent of integration time", number(curve.exponent, 3), "", f"±{number(curve.exponent_sigma, 2)}")]
    across, about = curve.across_rad / ARCSEC_RAD, curve.about_rad / ARCSEC_RAD
    plot = Plot(
        "Noise equivalent angle",
        "integration time, s",
        "arcsec",
        [
            Series("across", numbers(curve.exposure_s), maybe(across)),
            Series("about", numbers(curve.exposure_s), maybe(about)),
        ],
        log_y=True,
    )
    rows = [
        [number(t, 3), number(a, 3), number(b, 3), number(100 * r, 2), number(int(n)), number(m, 3)]
        for t, a, b, r, n, m in zip(
            numbers(curve.exposure_s),
            numbers(across),
            numbers(about),
            numbers(curve.relative_sigma),
            curve.frames,
            numbers(curve.matches),
            strict=True,
        )
    ]
    table = Table("By integration time", ["s", "across ″", "about ″", "± %", "frames", "stars"], rows)
    text = (
        "Photon noise gives the exponent −0.5, read noise −1; 0 means that another error dominates (Moniteq 1983 §4.4)."
    )
    return Report(
        "Noise against integration time",
        subject,
        [Section("Curve", text, facts, [plot], [table])],
        notes(curve.warnings),
    )


def spatial(pixels: Array, residual_px: Array, camera: Camera, subject: str) -> tuple[Report, dict[str, object]]:
    """Return the report of systematic centroid errors over the detector and within a pixel, and its values."""
    size = (camera.columns, camera.rows)
    field = residual_map(pixels, residual_px, size)
    mean = np.nan_to_num(np.hypot(field.mean_px[..., 0], field.mean_px[..., 1]))
    cell = camera.columns / len(field.col_px)
    scale = 0.9 * cell / float(mean.max()) if mean.max() > 0 else 1.0
    columns, rows = np.meshgrid(field.col_px, field.row_px)
    arrows = Arrows(
        "Mean residual",
        *size,
        numbers(columns.ravel()),
        numbers(rows.ravel()),
        maybe(field.mean_px[..., 0].ravel()),
        maybe(field.mean_px[..., 1].ravel()),
        scale,
        f"{len(pixels)} stars",
    )
    cells = Cells("Residual, rms", *size, [maybe(line) for line in field.rms_px], "px")
    phase = [phase_means(pixels[:, k], residual_px[:, k]) for k in (0, 1)]
    centres = [(k + 0.5) / PHASES - 0.5 for k in range(PHASES)]
    within = Plot(
        "Error against position within a pixel",
        "distance of the star from the pixel centre, px",
        "px",
        [Series("columns", centres, phase[0]), Series("rows", centres, phase[1])],
    )
    scatter = float(np.sqrt(np.mean(residual_px**2)))
    facts = [
        Fact("residual", number(scatter), "px", "rms per axis"),
        Fact(
            "systematic over the field",
            number(float(np.sqrt(np.nanmean(field.mean_px**2)))),
            "px",
            "rms of cell means",
        ),
        Fact("systematic within a pixel", number(rms(phase[0] + phase[1])), "px", "rms of phase means"),
        Fact("stars", number(len(pixels))),
    ]
    text = "Neighbouring arrows with the same direction are calibration errors; periodic errors within a pixel are centroid errors."
    report = Report("Spatial error", subject, [Section("Over the detector", text, facts, [arrows, cells, within])], [])
    return report, {"map": as_record(field), "phase_col_px": phase[0], "phase_row_px": phase[1], "rms_px": scatter}


def two_cameras(result: Consistency, subject: str) -> Report:
    """Return the report of the relative mounting of two cameras."""
    facts = [
        Fact("pairs", number(result.pairs)),
        Fact(
            "second from first",
            ", ".join(f"{float(q):.6f}".replace("-", "−") for q in result.second_from_first),
            "",
            "quaternion, scalar last",
        ),
        Fact("scatter ÷ scatter predicted by the covariances", number(result.chi, 3)),
    ]
    plot = over_time(
        "Deviation from the mean mounting", result.times_s, result.deviation_rad / ARCSEC_RAD, ("x", "y", "z"), "arcsec"
    )
    section = Section("Mounting", "In the second camera's axes.", facts, [plot], [axes_table(result.axes)])
    return Report("Two cameras", subject, [section], notes(result.warnings))


def telemetry(figures: TelemetryFigures, series: AttitudeSeries, subject: str) -> Report:
    """Return the report of a performance analysis from attitudes alone."""
    facts = [
        Fact("attitudes", f"{int(series.solved.sum())} of {len(series)}", "", f"{100 * figures.availability:.1f} %"),
        Fact("longest outage", number(figures.longest_outage_s, 3), "s"),
        Fact("stars matched", number(figures.mean_matches, 3), "", "mean"),
        Fact(
            "turn",
            number(float(np.degrees(np.median(figures.rate_rad_s))), 3) if figures.triples else "–",
            "°/s",
            "median",
        ),
        Fact("triples compared", number(figures.triples)),
    ]
    rows = [
        [name, number(finite(float(n)), 3), number(finite(float(3 * n)), 3), number(finite(float(c)), 3)]
        for name, n, c in zip(
            ("across, x", "across, y", "about"),
            figures.noise_rad / ARCSEC_RAD,
            figures.claimed_rad / ARCSEC_RAD,
            strict=True,
        )
    ]
    table = Table("Noise of one attitude", ["axis", "1σ ″", "3σ ″", "reported σ ″"], rows)
    plot = over_time(
        "Each attitude against the mean of its neighbours",
        figures.times_s,
        figures.deviation_rad / ARCSEC_RAD,
        ("x", "y", "about"),
        "arcsec",
    )
    return Report(
        "Telemetry statistics", subject, [Section("Noise", "", facts, [plot], [table])], notes(figures.warnings)
    )
