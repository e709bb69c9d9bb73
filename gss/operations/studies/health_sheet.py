"""Report of the health of a sensor: trends with forecasts, warm pixels, dark level, radiation over the Earth, and
proposed calibration."""

from __future__ import annotations

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.words import counted
from gss.operations.report.coasts import COASTS
from gss.operations.report.figures import number
from gss.operations.report.parts import (
    Cells,
    Drawing,
    Fact,
    Level,
    Plot,
    Report,
    Section,
    Series,
    Table,
    WorldMap,
)
from gss.operations.studies.health_words import day, forecast, health_notes, interval, signed, times, with_error
from gss.operations.studies.sheet_pieces import maybe, numbers
from gss.pipeline.health.frame_figures import COUNTS
from gss.pipeline.health.mission import FigureCourse, MissionHealth
from gss.pipeline.health.pixel_course import ANNEALING, GROWING, STEADY, PixelCourse
from gss.pipeline.health.proposal import Proposal, value_at
from gss.pipeline.health.trend import DAY_S, Estimate

MAX_LISTED = 100
YEAR_DAYS = 365.25
CELL_DEG = 15
MAP_CELLS = 12


def health_report(health: MissionHealth, proposal: Proposal, profile: CameraProfile, subject: str) -> Report:
    """Return the health report. ``profile``: calibration relative to which changes were measured."""
    camera = profile.camera
    sections = [
        Section("Summary", "", _summary(health)),
        Section(
            "Trends",
            "Each frame gives one value. The line follows all values up to a date, at the mean temperature. Intervals are 95 %.",
            [],
            [_trend_plot(f) for f in health.figures if f.trend is not None and f.name not in COUNTS],
            [_trends(health)],
        ),
        _pixels(health, camera.columns, camera.rows),
        Section("Dark level", _dark_text(health), _dark_facts(health), _dark_plots(health)),
        Section(
            "Radiation",
            "Hits are groups of pixels far above their usual value that no star explains, in a single frame.",
            _hit_facts(health),
            [world_of_hits(health), _hits_over_time(health)],
        ),
        Section(
            "Matches", "", [], [_trend_plot(f) for f in health.figures if f.trend is not None and f.name in COUNTS]
        ),
        _proposal(proposal, profile),
    ]
    return Report("Health of the sensor", subject, sections, health_notes(health, proposal))


# --- summary and trends ----------------------------------------------------------------------------------------------


def _summary(health: MissionHealth) -> list[Fact]:
    times_s = health.times_s
    new_pixels = [p for p in health.pixels if p.onset_s is not None]
    shapes = [p.shape for p in new_pixels]
    return [
        Fact("frames with an attitude", f"{len(times_s)} of {health.frames}"),
        Fact(
            "span",
            number(float(np.ptp(times_s)) / DAY_S, 3),
            "days",
            f"{day(float(times_s[0]))} to {day(float(times_s[-1]))}",
        ),
        Fact("warm pixels from the start", str(len(health.pixels) - len(new_pixels))),
        Fact(
            "pixels that became warm",
            str(len(new_pixels)),
            "",
            ", ".join(f"{shapes.count(name)} {name}" for name in (ANNEALING, GROWING, STEADY)),
        ),
        Fact("warm: dark current above", number(health.warm_e_s, 3), "e/s", "above the typical pixel"),
        Fact("temperature", _span(health.temperature_c), "°C"),
    ]


def _span(values: Array) -> str:
    finite = values[np.isfinite(values)]
    return f"{finite.min():.1f} to {finite.max():.1f}".replace("-", "−") if len(finite) else "unknown"


def _trends(health: MissionHealth) -> Table:
    end_s = float(health.times_s[-1])
    rows = []
    for figure in health.figures:
        if figure.trend is None or figure.name in COUNTS:
            continue
        jumps = "; ".join(f"{signed(j.size, 3)} on {day(j.time_s.value)}" for j in figure.trend.jumps) or "none"
        rows.append(
            [
                figure.name,
                figure.unit,
                with_error(value_at(figure.trend, end_s)),
                with_error(times(figure.trend.per_day, YEAR_DAYS)),
                "–" if figure.trend.per_k is None else with_error(figure.trend.per_k),
                jumps,
                "–"
                if figure.tolerance is None
                else with_error(
                    Estimate(figure.reference, figure.reference - figure.tolerance, figure.reference + figure.tolerance)
                ),
                forecast(figure, end_s),
            ]
        )
    column_titles = ["figure", "unit", "now", "per year", "per K", "jumps", "tolerance", "leaves tolerance"]
    return Table("Trends", column_titles, rows)


def _trend_plot(figure: FigureCourse) -> Plot:
    trend = figure.trend
    assert trend is not None  # noqa: S101 - the caller has checked it
    times_s = numbers(figure.times_s)
    series = [Series("frames", times_s, maybe(figure.values), "dots")]
    if figure.filtered is not None:
        series.append(Series("filtered", times_s, maybe(figure.filtered.values)))
    series.append(Series("trend", times_s, maybe(trend.at(figure.times_s))))
    levels = [Level(j.time_s.value, day(j.time_s.value), vertical=True) for j in trend.jumps]
    if figure.tolerance is not None:
        low, high = float(np.min(figure.values)), float(np.max(figure.values))
        for sign in (-1, 1):
            level = figure.reference + sign * figure.tolerance
            # A tolerance that is far outside the values is not drawn, because it would compress the values to a line.
            if low - (high - low) <= level <= high + (high - low):
                levels.append(Level(level, "tolerance"))
    return Plot(figure.name[0].upper() + figure.name[1:], "UTC", figure.unit or "stars", series, levels, time=True)


# --- pixels ----------------------------------------------------------------------------------------------------------


def _pixels(health: MissionHealth, columns: int, rows: int) -> Section:
    new_pixels = [p for p in health.pixels if p.onset_s is not None]
    drawings: list[Drawing] = []
    if health.pixels:
        drawings.append(_pixel_map(health.pixels, columns, rows))
    if new_pixels:
        onset = np.sort([p.onset_s.value for p in new_pixels if p.onset_s is not None])
        counts = np.arange(1, len(onset) + 1, dtype=float)
        drawings.append(
            Plot(
                "Pixels that became warm", "UTC", "pixels", [Series("pixels", numbers(onset), maybe(counts))], time=True
            )
        )
    pixel_rows = [_pixel_row(p) for p in health.pixels[:MAX_LISTED]]
    text = "Dark currents are relative to the typical pixel, at the mean temperature."
    if len(health.pixels) > MAX_LISTED:
        text += (
            f" The table shows the brightest {MAX_LISTED} of {len(health.pixels)} pixels; the CSV file contains all."
        )
    column_titles = [
        "column",
        "row",
        "course",
        "onset",
        "95 %",
        "at onset e/s",
        "now e/s",
        "half-life days",
        "growth e/s per year",
    ]
    return Section("Warm pixels", text, [], drawings, [Table("Pixels", column_titles, pixel_rows)])


def _pixel_map(pixels: tuple[PixelCourse, ...], columns: int, rows: int) -> Cells:
    row_bins = max(1, round(MAP_CELLS * rows / columns))
    counts, _, _ = np.histogram2d(
        [p.row for p in pixels], [p.col for p in pixels], bins=(row_bins, MAP_CELLS), range=((0, rows), (0, columns))
    )
    return Cells("Warm pixels over the detector", columns, rows, [maybe(line) for line in counts], "pixels")


def _pixel_row(pixel: PixelCourse) -> list[str]:
    onset, between = ("before the first frame", "–")
    if pixel.onset_s is not None:
        onset, between = day(pixel.onset_s.value), f"{day(pixel.onset_s.low)} – {day(pixel.onset_s.high)}"
    life = "–" if pixel.half_life_s is None else interval(times(pixel.half_life_s, 1 / DAY_S))
    return [
        str(pixel.col),
        str(pixel.row),
        pixel.shape,
        onset,
        between,
        with_error(pixel.first_e_s),
        with_error(pixel.now_e_s),
        life,
        "–" if pixel.growth_e_s_year is None else with_error(pixel.growth_e_s_year),
    ]


# --- dark level and radiation ----------------------------------------------------------------------------------------


def _dark_text(health: MissionHealth) -> str:
    if health.dark.law_known:
        return (
            "Sky level fitted by the diode law of the dark current, light that grows with the exposure, and a constant."
        )
    return "The temperatures are unknown or vary by less than 5 K. The law cannot be determined, so the law of silicon is used."


def _dark_facts(health: MissionHealth) -> list[Fact]:
    dark = health.dark
    if not dark.law_known:
        return []
    return [
        Fact(
            "dark current of the typical pixel",
            with_error(dark.at_reference_e_s),
            "e/s",
            f"at {dark.reference_c:.1f} °C",
        ),
        Fact("doubles every", with_error(dark.doubling_k), "K"),
        Fact("growth", with_error(times(dark.growth_per_year, 100.0)), "% per year"),
    ]


def _dark_plots(health: MissionHealth) -> list[Drawing]:
    plots: list[Drawing] = []
    measured = np.isfinite(health.temperature_c)
    if measured.any():
        level_over_temperature = Series(
            "frames", numbers(health.temperature_c[measured]), maybe(health.level_dn[measured]), "dots"
        )
        plots.append(Plot("Sky level against temperature", "temperature, °C", "DN", [level_over_temperature]))
    level_over_time = Series("frames", numbers(health.times_s), maybe(health.level_dn), "dots")
    return [*plots, Plot("Sky level", "UTC", "DN", [level_over_time], time=True)]


def _hit_facts(health: MissionHealth) -> list[Fact]:
    return [
        Fact("hits per frame", number(float(health.particles.mean()), 3), "", f"at most {health.particles.max()}"),
        Fact("frames with a known position", str(int(np.isfinite(health.place_rad).all(axis=1).sum()))),
    ]


def world_of_hits(health: MissionHealth) -> WorldMap:
    """Return the mean number of hits per frame over latitude and longitude."""
    located = np.isfinite(health.place_rad).all(axis=1)
    north, east = np.degrees(health.place_rad[located]).T if located.any() else (np.zeros(0), np.zeros(0))
    bins = (180 // CELL_DEG, 360 // CELL_DEG)
    edges = ((-90, 90), (-180, 180))
    total, _, _ = np.histogram2d(north, east, bins=bins, range=edges, weights=health.particles[located].astype(float))
    frames, _, _ = np.histogram2d(north, east, bins=bins, range=edges)
    mean = np.where(frames > 0, total / np.maximum(frames, 1), np.nan)[::-1]
    return WorldMap(
        "Radiation hits below the spacecraft",
        [maybe(line) for line in mean],
        "hits per frame",
        COASTS,
        "cells without a frame are empty; coasts are approximate",
    )


def _hits_over_time(health: MissionHealth) -> Plot:
    series = [Series("hits", numbers(health.times_s), maybe(health.particles.astype(float)), "dots")]
    return Plot("Radiation hits", "UTC", "hits per frame", series, time=True)


# --- proposal and notes ----------------------------------------------------------------------------------------------


def _proposal(proposal: Proposal, profile: CameraProfile) -> Section:
    bad_pixels = counted(len(proposal.bad), "bad pixel")
    if not proposal.changes:
        return Section("Proposed calibration", f"No value of {profile.name} has changed significantly; {bad_pixels}.")
    rows = [[c.name, number(c.old, 7), number(c.new.value, 7), interval(c.new, 7), c.unit] for c in proposal.changes]
    text = (
        f"Values at the time of the last frame, at the mean temperature, and {bad_pixels}. All other values are unchanged. "
        "Store the calibration to create tables of these values and of the bad pixels for the sensor. If its interface has "
        "no bad-pixel table, only ground reruns replace the bad pixels."
    )
    return Section(
        "Proposed calibration", text, [], [], [Table("Changes", ["value", "now", "proposed", "95 %", "unit"], rows)]
    )
