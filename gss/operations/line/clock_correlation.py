"""Which moment of UTC is which moment of the device's clock, from the times of what arrives, and how well that is known.

Each packet says the device's time and arrives a little later than it was made: received − device time is the offset of the
clocks plus a delay that is never negative. So the smallest differences are the best ones (as in NTP's clock filter, RFC 5905
§10); their slope is the drift. All times are seconds; UTC as Unix time.
"""

from __future__ import annotations

import statistics
from collections import deque
from dataclasses import dataclass

KEPT = 600
LEAST_SAMPLES = 3
SPAN_FOR_DRIFT_S = 60.0
JUMP_S = 1.0
JUMPED_AFTER = 5
"""So many late samples in a row are a clock that jumped; fewer are a line that stalled."""
LEAST_DELAY_S = 0.05
"""Time on the line and in the reader that no difference shows."""
UNKNOWN_DRIFT = 100e-6
LEAST_DRIFT = 1e-6


@dataclass(frozen=True)
class Correlation:
    """``device_s`` is the device's clock at ``utc_s``. ``drift``: seconds that it gains per second, None while unknown.
    ``uncertainty_s`` holds at that moment and grows by ``drift_uncertainty`` per second away from it."""

    utc_s: float
    device_s: float
    drift: float | None
    uncertainty_s: float
    drift_uncertainty: float
    samples: int
    span_s: float

    def device_of(self, utc_s: float) -> float:
        """The device's clock at a moment of UTC."""
        return self.device_s + (utc_s - self.utc_s) * (1 + (self.drift or 0.0))

    def utc_of(self, device_s: float) -> float:
        """The moment of UTC at which the device's clock shows that."""
        return self.utc_s + (device_s - self.device_s) / (1 + (self.drift or 0.0))

    def uncertainty_at(self, utc_s: float) -> float:
        """How far off the above may be."""
        return self.uncertainty_s + abs(utc_s - self.utc_s) * self.drift_uncertainty


class ClockTracker:
    """Takes (received, device time) pairs in the order of their arrival. A clock that jumped is begun anew."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, float]] = deque(maxlen=KEPT)
        self._least: deque[tuple[float, float]] = deque()
        """The sample of the smallest difference, then that of the smallest among those behind it, and on."""
        self._late: list[tuple[float, float]] = []

    def restart(self) -> None:
        """The device's clock was set or its owner changed: what was known is void."""
        self._samples.clear()
        self._least.clear()
        self._late.clear()

    def add(self, received_s: float, device_s: float) -> None:
        """One packet."""
        sample = (received_s, device_s)
        if not self._samples:
            self._keep(sample)
            return
        (point_s, point_device_s), slope = self._line()
        expected_s = point_device_s + (received_s - point_s) * (1 - (slope or 0.0))
        excess_s = expected_s - device_s  # positive: later than expected
        if excess_s < -JUMP_S:
            self.restart()
        elif excess_s > JUMP_S:
            self._late.append(sample)
            if len(self._late) < JUMPED_AFTER:
                return
            late = self._late[:]
            self.restart()
            for one in late:
                self._keep(one)
            return
        self._late.clear()
        self._keep(sample)

    def _keep(self, sample: tuple[float, float]) -> None:
        """The smallest difference is known without looking through all: packets may come by the thousand in a second."""
        if len(self._samples) == KEPT and self._least[0] is self._samples[0]:
            self._least.popleft()
        self._samples.append(sample)
        while self._least and _difference(self._least[-1]) > _difference(sample):
            self._least.pop()
        self._least.append(sample)

    def estimate(self) -> Correlation | None:
        """What is known; None before enough has come."""
        return self._fit() if len(self._samples) >= LEAST_SAMPLES else None

    def _line(self) -> tuple[tuple[float, float], float | None]:
        """The sample that the clocks are laid through, and the slope of the differences; None while the span is too short."""
        samples = self._samples
        span_s = samples[-1][0] - samples[0][0]
        if span_s < SPAN_FOR_DRIFT_S:
            return self._least[0], None
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
            uncertainty_s=LEAST_DELAY_S + jitter_s,
            drift_uncertainty=UNKNOWN_DRIFT if slope is None else max(LEAST_DRIFT, 2 * jitter_s / span_s),
            samples=len(samples),
            span_s=span_s,
        )


def _difference(sample: tuple[float, float]) -> float:
    """Received less device time: the clocks' offset and the packet's delay."""
    return sample[0] - sample[1]
