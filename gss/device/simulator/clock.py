"""Device clock: counts from its first start and can drift and jump. UTC is set by SET_TIME."""

from __future__ import annotations

from gss.device.simulator.memory import Memory

PPM = 1e-6


class DeviceClock:
    """Device time as a function of simulated time, in seconds. Both are equal while the clock has no fault."""

    def __init__(self, memory: Memory, start_s: float) -> None:
        self._memory = memory
        self._from_s, self._base_s = start_s, start_s
        self.drift_ppm = 0.0

    def at(self, simulated_s: float) -> float:
        """Return the device time."""
        return self._base_s + (simulated_s - self._from_s) * (1 + self.drift_ppm * PPM)

    def set_drift(self, ppm: float, simulated_s: float) -> None:
        """Set the clock's drift in parts per million (positive: fast) from ``simulated_s`` on."""
        self._from_s, self._base_s = simulated_s, self.at(simulated_s)
        self.drift_ppm = ppm

    def jump(self, seconds: float, simulated_s: float) -> float:
        """Shift the clock by ``seconds``, never below zero. Returns the actual shift."""
        before = self.at(simulated_s)
        self._from_s, self._base_s = simulated_s, max(0.0, before + seconds)
        return self._base_s - before

    def set_utc(self, utc_s: float, simulated_s: float) -> None:
        """Store the offset from device time to UTC (SET_TIME)."""
        self._memory.record.utc_offset_s = utc_s - self.at(simulated_s)
        self._memory.save()

    def utc_s(self, simulated_s: float) -> float:
        """Return UTC in seconds since 1970, NaN before SET_TIME."""
        offset_s = self._memory.record.utc_offset_s
        return float("nan") if offset_s is None else self.at(simulated_s) + offset_s
