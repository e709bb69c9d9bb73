"""Tick positions on an axis and their labels."""

from __future__ import annotations

import math
from datetime import UTC, datetime

MINUS = "\N{MINUS SIGN}"
DAY_S = 86400
DAYS = (1, 2, 7, 14, 30, 60, 120, 365, 1461)


def ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Return about ``about`` round values from low to high."""
    if not (math.isfinite(low) and math.isfinite(high)) or high <= low:
        return []
    raw = (high - low) / max(1, about)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1, 2, 2.5, 5, 10) if m * power >= raw * (1 - 1e-9))
    first = math.ceil(low / step - 1e-9)
    return [round(k * step, 12) for k in range(first, math.floor(high / step + 1e-9) + 1)]


def decades(low: float, high: float) -> list[float]:
    """Return the powers of ten from low to high, which must both be positive."""
    return [10.0**k for k in range(math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9) + 1)]


def log_ticks(low: float, high: float) -> list[float]:
    """Return the powers of ten from low to high. If there are fewer than three, also return twice and five times each
    power."""
    powers = decades(low, high)
    if len(powers) >= 3:
        return powers
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    return [m * 10.0**k for k in range(first, last + 1) for m in (1, 2, 5) if low <= m * 10.0**k <= high]


def time_ticks(low: float, high: float) -> list[float]:
    """Return ticks at whole seconds, minutes, hours or days. ``low``, ``high`` and the ticks are in Unix seconds."""
    steps = (1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600, 7200, 21600, 43200, *(DAY_S * d for d in DAYS))
    step = next((s for s in steps if (high - low) / s <= 6), DAY_S * DAYS[-1])
    return [float(k * step) for k in range(math.ceil(low / step), math.floor(high / step) + 1)]


def written(value: float, step: float) -> str:
    """Format a tick label with the decimals that the step of its axis needs and a true minus sign."""
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < 1e6:
        return f"{value:.1e}".replace("-", MINUS)
    digits = max(0, -math.floor(math.log10(step) + 1e-9)) if step > 0 else 3
    if step > 0 and abs(step * 10**digits - round(step * 10**digits)) > 1e-6:
        digits += 1
    return f"{value:.{digits}f}".replace("-", MINUS)


def clock(unix_s: float, span_s: float) -> str:
    """Format the time of day in UTC. An axis of a day or more also shows the date; an axis of more than 12 days shows
    only the date."""
    form = "%H:%M:%S" if span_s < 3600 else "%H:%M" if span_s < DAY_S else "%m-%d %H:%M"
    form = "%Y-%m-%d" if span_s > 12 * DAY_S else form
    return datetime.fromtimestamp(unix_s, UTC).strftime(form)
