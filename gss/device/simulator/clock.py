"""The device's clock: counts from its first start, may run fast or slow, may jump; and UTC as far as it was told."""

from __future__ import annotations

from gss.device.simulator.memory import Memory

PPM = 1e-6


class DeviceClock:
    """Device time at simulated times (both in seconds since the same zero while the clock is healthy)."""

    def __init__(self, memory: Memory, start_s: float) -> None:
        self._memory = memory
        self._from_s, self._base_s = start_s, start_s
        self.drift_ppm = 0.0

    def at(self, simulated_s: float) -> float:
        """What the clock shows."""
        return self._base_s + (simulated_s - self._from_s) * (1 + self.drift_ppm * PPM)

    def set_drift(self, ppm: float, simulated_s: float) -> None:
        """From now on so many parts per million fast."""
        self._from_s, self._base_s = simulated_s, self.at(simulated_s)
        self.drift_ppm = ppm

    def jump(self, seconds: float, simulated_s: float) -> float:
        """Jump; never below zero. How far it went."""
        before = self.at(simulated_s)
        self._from_s, self._base_s = simulated_s, max(0.0, before + seconds)
        return self._base_s - before

    def set_utc(self, utc_s: float, simulated_s: float) -> None:
        """SET_TIME."""
        self._memory.record.utc_offset_s = utc_s - self.at(simulated_s)
        self._memory.save()

    def utc_s(self, simulated_s: float) -> float:
        """UTC, not-a-number before SET_TIME."""
        offset_s = self._memory.record.utc_offset_s
        return float("nan") if offset_s is None else self.at(simulated_s) + offset_s
