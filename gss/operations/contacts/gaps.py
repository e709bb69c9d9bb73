"""Detection of gaps in the housekeeping record. Each gap has a cause or is "unexplained".

A gap is an interval of more than one and a half periods between housekeeping packets on the *device's* clock. Packets that
arrived late do not form a gap. The cause is derived from other records: missing sequence counts, damaged packets, a restart of
the device, a clock that was set, a closed line, or a server that could not store telemetry. Silence alone is not a cause,
because the device can have stopped sending.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

PERIOD_S = 1.0
"""Longest housekeeping period that the ICD permits. If a device uses a shorter period, the period is measured from the
record."""
MIN_STEPS = 20
"""Minimum number of intervals between packets for measuring the period."""
GAP_PERIODS = 1.5
LATE_S = 3.0
CATCH_UP_SAMPLES = 40
"""Number of packets after a late one in which a device returns to its schedule."""
SLACK_S = 1.5
"""Time tolerance for assigning events to gaps. Counters are read once a second, so an event can be recorded up to a
second late."""
UNEXPLAINED = "unexplained"
RESTARTED, CLOCK_SET, CLOCK_JUMPED = "restarted", "clock set", "clock jumped"
RESETS = (RESTARTED,)
CLOCKS = (CLOCK_SET, CLOCK_JUMPED)
LINE_LOST = "LINE_LOST"
NOT_STORED = "NOT_STORED"
"""The server received telemetry that it could not store, or it can store telemetry again."""
GROUND_CLOCK = "GROUND_CLOCK_JUMP"
"""The ground's clock, which determines arrival times, was set. The device's clock did not change."""
DAMAGE = ("bad_crc", "too_long", "too_short")


@dataclass(frozen=True)
class HousekeepingSample:
    """One housekeeping packet. ``at_s``: time of arrival, Unix seconds. ``device_time_s``: device clock in the
    packet, or ``at_s`` if the packet has none."""

    at_s: float
    device_time_s: float
    uptime_s: float | None = None
    contact_id: int | None = None


@dataclass(frozen=True)
class Count:
    """Receive counters of a contact at one time. ``values``: gaps, bad_crc, too_long, too_short, good …"""

    at_s: float
    values: Mapping[str, float]
    contact_id: int | None = None


@dataclass(frozen=True)
class Happening:
    """An event of the device or of the line."""

    at_s: float
    name: str
    text: str = ""


@dataclass(frozen=True)
class Gap:
    """An interval between two samples. ``missing``: number of missing packets; 0 if all were received but arrived late."""

    from_s: float
    to_s: float
    missing: int
    cause: str

    @property
    def explained(self) -> bool:
        """True if a cause is known."""
        return not self.cause.startswith(UNEXPLAINED)


@dataclass(frozen=True)
class RecordCheck:
    """Result of checking a record. ``expected``, ``held``: numbers of expected and stored packets. ``late``: intervals in which
    all packets arrived, but late."""

    expected: int
    held: int
    gaps: tuple[Gap, ...]
    late: tuple[Gap, ...]

    @property
    def unexplained(self) -> tuple[Gap, ...]:
        """Gaps without a cause."""
        return tuple(gap for gap in self.gaps if not gap.explained)

    @property
    def share(self) -> float:
        """Fraction of the expected packets that are stored, 1 for an empty record."""
        return self.held / self.expected if self.expected else 1.0


def check_record(
    samples: Sequence[HousekeepingSample],
    counts: Sequence[Count],
    happenings: Sequence[Happening],
    *,
    start_s: float | None = None,
    end_s: float | None = None,
) -> RecordCheck:
    """Check the periodic samples of a record, which must be in order of time. ``start_s``, ``end_s``: start and end of the
    contact; if given, the time before the first sample and after the last sample is also checked."""
    gaps: list[Gap] = []
    late: list[Gap] = []
    evidence = _Evidence(counts, happenings)
    period_s = _period_s(samples)
    for i, (before, after) in enumerate(itertools.pairwise(samples)):
        gap = _between(before, after, evidence, period_s)
        if gap is not None and (gap.explained or not _catches_up(samples, i, period_s)):
            (gaps if gap.missing else late).append(gap)
    gaps += _ends(samples, evidence, start_s, end_s, period_s)
    gaps.sort(key=lambda gap: gap.from_s)
    present = len(samples)
    return RecordCheck(present + sum(gap.missing for gap in gaps), present, tuple(gaps), tuple(late))


def why_silent(
    from_s: float, to_s: float, counts: Sequence[Count], happenings: Sequence[Happening], contact_id: int | None
) -> str:
    """Return the reason why no good packet was received in an interval of a contact."""
    evidence = _Evidence(counts, happenings)
    boot = evidence.happened(RESETS, from_s, to_s)
    if boot is not None and evidence.happened((LINE_LOST,), from_s, to_s) is None:
        return "the device restarted" + (f" ({boot.text})" if boot.text else "")
    return evidence.cause(from_s, to_s, contact_id)


class _Evidence:
    """Counters and events that can explain a gap."""

    def __init__(self, counts: Sequence[Count], happenings: Sequence[Happening]) -> None:
        self._counts, self._happenings = counts, happenings

    def happened(self, names: Sequence[str], from_s: float, to_s: float) -> Happening | None:
        """Return the first event with one of these names in an interval, None if there is none."""
        return next(
            (h for h in self._happenings if h.name in names and from_s - SLACK_S <= h.at_s <= to_s + SLACK_S), None
        )

    def risen(self, from_s: float, to_s: float, contact_id: int | None) -> dict[str, float]:
        """Return the increase of each counter of a contact from the last count before an interval to the first count after
        it."""
        counts = [c for c in self._counts if c.contact_id == contact_id]
        before = next((c.values for c in reversed(counts) if c.at_s <= from_s), {})
        after = next((c.values for c in counts if c.at_s >= to_s), counts[-1].values if counts else {})
        return {name: value - before.get(name, 0) for name, value in after.items()}

    def cause(self, a_s: float, b_s: float, contact_id: int | None) -> str:
        """Return the reason why packets of an interval are missing."""
        lost_line = self.happened((LINE_LOST,), a_s, b_s)
        if lost_line is not None:
            return f"the line was lost ({lost_line.text})"
        unstored = self.happened((NOT_STORED,), a_s, b_s)
        if unstored is not None:
            return f"not stored by the server: {unstored.text}"
        risen = self.risen(a_s, b_s, contact_id)
        lost, damaged = risen.get("gaps", 0), sum(risen.get(name, 0) for name in DAMAGE)
        if lost > 0:
            damage = f"; {damaged:g} packets with a bad checksum or length were received" if damaged else ""
            return f"lost on the line: {lost:g} packets missing by their sequence counts{damage}"
        if damaged > 0:
            return f"damaged on the line: {damaged:g} packets with a bad checksum or length"
        return UNEXPLAINED


def _period_s(samples: Sequence[HousekeepingSample]) -> float:
    """Return the device's housekeeping period: the median step of its clock, but at most ``PERIOD_S``."""
    steps = sorted(
        b.device_time_s - a.device_time_s
        for a, b in itertools.pairwise(samples)
        if a.contact_id == b.contact_id and b.device_time_s > a.device_time_s
    )
    return min(PERIOD_S, steps[len(steps) // 2]) if len(steps) >= MIN_STEPS else PERIOD_S


def _catches_up(samples: Sequence[HousekeepingSample], index: int, period_s: float) -> bool:
    """True if shorter steps after a long step of the device's clock make up for it. The packets were then sent late by a
    busy device, and none is missing. ``index``: of the sample before the long step."""
    first = samples[index]
    return any(
        sample.contact_id == first.contact_id and sample.device_time_s - first.device_time_s <= (m + 0.5) * period_s
        for m, sample in enumerate(samples[index + 2 : index + 2 + CATCH_UP_SAMPLES], 2)
    )


def _between(before: HousekeepingSample, after: HousekeepingSample, evidence: _Evidence, period_s: float) -> Gap | None:
    """Return the gap or the late interval between two consecutive samples, None if there is none."""
    if before.contact_id != after.contact_id:
        missing = max(0, round((after.at_s - before.at_s) / period_s) - 1)
        return Gap(before.at_s, after.at_s, missing, "the line was closed in this time") if missing else None
    device_step_s, ground_step_s = after.device_time_s - before.device_time_s, after.at_s - before.at_s
    restarted = after.uptime_s is not None and before.uptime_s is not None and after.uptime_s < before.uptime_s
    if ground_step_s < -SLACK_S or evidence.happened((GROUND_CLOCK,), after.at_s - SLACK_S, after.at_s) is not None:
        missing = max(0, round(device_step_s / period_s) - 1)  # the ground's clock jumped: use the device's clock
        lost = missing and not restarted and device_step_s > GAP_PERIODS * period_s
        return (
            Gap(before.at_s, after.at_s, missing, evidence.cause(after.at_s, after.at_s, before.contact_id))
            if lost
            else None
        )
    boot = evidence.happened(RESETS, before.at_s, after.at_s)
    clock = evidence.happened(CLOCKS, before.at_s, after.at_s)
    if restarted or clock is not None or device_step_s <= 0:
        missing = max(0, round(ground_step_s / period_s) - 1)  # the device's clock was set: use the ground's clock
        if ground_step_s <= GAP_PERIODS * period_s or not missing:
            return None
        if restarted:
            detail = f" ({boot.text})" if boot is not None and boot.text else ""
            return Gap(before.at_s, after.at_s, missing, f"the device restarted{detail}")
        return Gap(before.at_s, after.at_s, missing, evidence.cause(before.at_s, after.at_s, before.contact_id))
    if device_step_s > GAP_PERIODS * period_s:
        missing = max(1, round(device_step_s / period_s) - 1)
        return Gap(before.at_s, after.at_s, missing, evidence.cause(before.at_s, after.at_s, before.contact_id))
    if ground_step_s > LATE_S:
        return Gap(before.at_s, after.at_s, 0, "received late: the line stalled, nothing is missing")
    return None


def _ends(
    samples: Sequence[HousekeepingSample],
    evidence: _Evidence,
    start_s: float | None,
    end_s: float | None,
    period_s: float,
) -> list[Gap]:
    """Return the gap between opening the line and the first sample, and the gap between the last sample and closing the
    line."""
    if not samples:
        if start_s is None or end_s is None or end_s - start_s <= LATE_S:
            return []
        missing = round((end_s - start_s) / period_s)
        return [Gap(start_s, end_s, missing, f"{UNEXPLAINED}: no packet received")]
    gaps = []
    first, last = samples[0], samples[-1]
    if start_s is not None and first.at_s - start_s > LATE_S:
        missing = round((first.at_s - start_s) / period_s)
        started_later = first.uptime_s is not None and first.uptime_s < first.at_s - start_s
        cause = (
            "the device was not running yet" if started_later else evidence.cause(start_s, first.at_s, first.contact_id)
        )
        gaps.append(Gap(start_s, first.at_s, missing, cause))
    if end_s is not None and end_s - last.at_s > LATE_S:
        missing = round((end_s - last.at_s) / period_s)
        cause = evidence.cause(last.at_s, end_s, last.contact_id)
        if cause == UNEXPLAINED:
            cause = f"{UNEXPLAINED}: no data until the line was closed"
        gaps.append(Gap(last.at_s, end_s, missing, cause))
    return gaps
