"""Texts of a health report: values with errors, forecasts, and notes."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from gss.operations.report.figures import number
from gss.operations.report.parts import Note
from gss.pipeline.health.mission import FigureCourse, MissionHealth
from gss.pipeline.health.proposal import Proposal
from gss.pipeline.health.trend import DAY_S, Estimate

SOON_DAYS = 180.0
"""A value that will leave its tolerance within this number of days raises a note."""


def health_notes(health: MissionHealth, proposal: Proposal) -> list[Note]:
    """Return notes about values outside their tolerance, forecasts, jumps, and changes that cannot be proposed."""
    end_s = float(health.times_s[-1])
    notes = []
    for f in health.figures:
        leaves = f.leaves
        if leaves is None:
            continue
        if leaves.outside:
            notes.append(
                Note(
                    f"{f.name} is outside its tolerance",
                    "Check whether the proposed calibration corrects this value. If it is the star width, check the focus.",
                    True,
                    "tolerance",
                )
            )
        elif (leaves.time_s.value - end_s) / DAY_S <= SOON_DAYS:
            notes.append(
                Note(f"{f.name} leaves its tolerance {forecast(f, end_s)}", "Plan a new calibration.", code="tolerance")
            )
    notes += [
        Note(
            f"{f.name} changed by {signed(jump.size, 3)} {f.unit} between {day(jump.time_s.low)} and {day(jump.time_s.high)}",
            "Search for the cause at this time.",
            code="jump",
        )
        for f in health.figures
        for jump in (() if f.trend is None else f.trend.jumps)
    ]
    notes += [
        Note(f"not proposed: {reason}", "Calibrate from star frames.", code="lens") for reason in proposal.left_out
    ]
    if not np.isfinite(health.temperature_c).any():
        notes.append(
            Note(
                "the temperature is unknown, so its changes can appear as jumps of the lens and as growth or annealing of pixels",
                "State the temperatures of the frames.",
                code="temperature",
            )
        )
    if not np.isfinite(health.place_rad).any():
        notes.append(
            Note("the map of radiation hits is empty", "State the orbit of the spacecraft.", code="place"),
        )
    return notes


def forecast(figure: FigureCourse, now_s: float) -> str:
    """Return a text that states when a value will leave its tolerance."""
    leaves = figure.leaves
    if leaves is None:
        return "–"
    if leaves.outside:
        return "outside now"
    value, low, high = ((v - now_s) / DAY_S for v in (leaves.time_s.value, leaves.time_s.low, leaves.time_s.high))
    if not np.isfinite(value):
        return "not within 30 years"
    latest_days = f"{high:.0f}" if np.isfinite(high) else "never"
    return f"in about {value:.0f} days ({low:.0f} to {latest_days})"


def times(estimate: Estimate, factor: float) -> Estimate:
    """Return an estimate multiplied by a factor, for another unit."""
    return Estimate(estimate.value * factor, estimate.low * factor, estimate.high * factor)


def with_error(estimate: Estimate) -> str:
    """Return a value with its error, which is half of the interval. The error has two significant digits, and the value
    has as many decimals as the error."""
    half = (estimate.high - estimate.low) / 2
    if not np.isfinite(half) or half <= 0:
        return number(estimate.value, 3)
    decimals = max(0, 1 - int(np.floor(np.log10(half))))
    return f"{estimate.value:.{decimals}f} ± {half:.{decimals}f}".replace("-", "−")


def interval(estimate: Estimate, digits: int = 3) -> str:
    """Return the bounds of an estimate. If there is no upper bound, return the value and the lower bound."""
    if not np.isfinite(estimate.high):
        return f"{number(estimate.value, digits)}, at least {number(estimate.low, digits)}"
    return f"{number(estimate.low, digits)} – {number(estimate.high, digits)}"


def signed(estimate: Estimate, digits: int) -> str:
    """Return the value of an estimate with its sign."""
    return f"{'+' if estimate.value > 0 else ''}{number(estimate.value, digits)}"


def day(unix_s: float) -> str:
    """Return the date of a Unix time."""
    return f"{datetime.fromtimestamp(unix_s, UTC):%Y-%m-%d}"
