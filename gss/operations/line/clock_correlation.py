"""Estimation of the relation between UTC and the device's clock, with its uncertainty, from the arrival times of packets.

Each packet contains the device time at which it was created, and arrives shortly afterwards. The difference (received −
device time) is the clock offset plus a delay that is never negative. Therefore the samples with the smallest
differences are the most accurate (as in NTP's clock filter, RFC 5905 §10). The slope of the smallest differences is the
drift. All times are in seconds; UTC is Unix time.
"""

from __future__ import annotations

import statistics
from collections import deque
from dataclasses import dataclass

KEPT = 600
MIN_SAMPLES = 3
SPAN_FOR_DRIFT_S = 60.0
JUMP_S = 1.0
JUMPED_AFTER = 5
"""Number of consecutive late samples after which a clock jump is assumed. Fewer late samples mean that the line stalled."""
MIN_DELAY_S = 0.05
"""Assumed constant delay on the line and in the reader. The differences do not show this delay, because it adds to the
clock offset."""
UNKNOWN_DRIFT = 100e-6
MIN_DRIFT = 1e-6


@dataclass(frozen=True)
class Correlation:
    """Relation of the two clocks: the device's clock shows ``device_s`` at ``utc_s``. ``drift``: seconds that the
    device's clock gains per second, None if unknown. ``uncertainty_s``: uncertainty at ``utc_s``. The uncertainty grows
    by ``drift_uncertainty`` for each second before or after ``utc_s``."""

    utc_s: float
    device_s: float
    drift: float | None
    uncertainty_s: float
    drift_uncertainty: float
    samples: int
    span_s: float

    def device_of(self, utc_s: float) -> float:
        """Return the device's clock at a time in UTC."""
        return self.device_s + (utc_s - self.utc_s) * (1 + (self.drift or 0.0))

    def utc_of(self, device_s: float) -> float:
        """Return the UTC at which the device's clock shows ``device_s``."""
        return self.utc_s + (device_s - self.device_s) / (1 + (self.drift or 0.0))

    def uncertainty_at(self, utc_s: float) -> float:
        """Return the uncertainty of the relation at ``utc_s``, in seconds."""
        return self.uncertainty_s + abs(utc_s - self.utc_s) * self.drift_uncertainty


class ClockTracker:
    """Estimates the clock relation from (received, device time) pairs, which are added in order of arrival. The estimate restarts
    after a clock jump."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, float]] = deque(maxlen=KEPT)
        self._minima: deque[tuple[float, float]] = deque()
        """Sliding-window minimum: the sample with the smallest difference, followed by the sample with the smallest
        difference among the later samples, and so on."""
        self._late: list[tuple[float, float]] = []

    def restart(self) -> None:
        """Discard all samples, because the device's clock was set or another device is connected."""
        self._samples.clear()
        self._minima.clear()
        self._late.clear()

    def add(self, received_s: float, device_s: float) -> None:
        """Add the times of one packet."""
        sample = (received_s, device_s)
        if not self._samples:
            self._keep(sample)
            return
        (point_s, point_device_s), slope = self._line()
        expected_s = point_device_s + (received_s - point_s) * (1 - (slope or 0.0))
        excess_s = expected_s - device_s  # positive if the packet arrived later than expected
        if excess_s < -JUMP_S:
            self.restart()
        elif excess_s > JUMP_S:
            self._late.append(sample)
            if len(self._late) < JUMPED_AFTER:
                return
            late = self._late[:]
            self.restart()
            for late_sample in late:
                self._keep(late_sample)
            return
        self._late.clear()
        self._keep(sample)

    def _keep(self, sample: tuple[float, float]) -> None:
        """Store the sample. The minimum is updated incrementally, because thousands of packets can arrive in a second."""
        if len(self._samples) == KEPT and self._minima[0] is self._samples[0]:
            self._minima.popleft()
        self._samples.append(sample)
        while self._minima and _difference(self._minima[-1]) > _difference(sample):
            self._minima.pop()
        self._minima.append(sample)

    def estimate(self) -> Correlation | None:
        """Return the estimate, None with fewer than ``MIN_SAMPLES`` samples."""
        return self._fit() if len(self._samples) >= MIN_SAMPLES else None

    def _line(self) -> tuple[tuple[float, float], float | None]:
        """Return the reference sample of the fit and the slope of the differences (None if the time span is too short)."""
        samples = self._samples
        span_s = samples[-1][0] - samples[0][0]
        if span_s < SPAN_FOR_DRIFT_S:
            return self._minima[0], None
        middle_s = samples[0][0] + span_s / 2
        older = min((s for s in samples if s[0] < middle_s), key=_difference)
        newer = min((s for s in samples if s[0] >= middle_s), key=_difference)
        between_s = newer[0] - older[0]
        if between_s < SPAN_FOR_DRIFT_S / 4:
            return newer, None
        return newer, (_difference(newer) - _difference(older)) / between_s

    def _fit(self) -> Correlation:
        samples, (point, slope) = list(self._samples), self._line()
        at_s, device_s = point
        excess = [_difference(s) - _difference(point) - (slope or 0.0) * (s[0] - at_s) for s in samples]
        jitter_s, span_s = statistics.median(map(abs, excess)), samples[-1][0] - samples[0][0]
        return Correlation(
            utc_s=at_s,
            device_s=device_s,
            drift=None if slope is None else -slope,
            uncertainty_s=MIN_DELAY_S + jitter_s,
            drift_uncertainty=UNKNOWN_DRIFT if slope is None else max(MIN_DRIFT, 2 * jitter_s / span_s),
            samples=len(samples),
            span_s=span_s,
        )


def _difference(sample: tuple[float, float]) -> float:
    """Return received time minus device time, which is the clock offset plus the delay of the packet."""
    return sample[0] - sample[1]
