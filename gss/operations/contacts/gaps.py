"""Finds the gaps in the housekeeping record, each with its cause or "unexplained".

A gap is found on the *device's* clock: housekeeping packets more than one and a half periods apart. Packets that only arrived
late are not a gap. The causes are derived from other records: missing sequence counts, damaged packets, a restart of the
device, a clock that was set, a closed line, a server that could not store. Silence alone explains nothing, because the device
itself may have stopped sending.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

PERIOD_S = 1.0
"""Longest period of housekeeping (ICD). A device that sends more often has the period that its record shows."""
MIN_STEPS = 20
"""Fewer steps of the device's clock do not show a period."""
GAP_PERIODS = 1.5
LATE_S = 3.0
SLACK_S = 1.5
"""Tolerance for matching events: counters are read once a second, so an event may be recorded that much later."""
UNEXPLAINED = "unexplained"
RESTARTED, CLOCK_SET, CLOCK_JUMPED = "restarted", "clock set", "clock jumped"
RESETS = (RESTARTED,)
CLOCKS = (CLOCK_SET, CLOCK_JUMPED)
LINE_LOST = "LINE_LOST"
NOT_STORED = "NOT_STORED"
"""The server received telemetry that it could not store, or stores it again."""
GROUND_CLOCK = "GROUND_CLOCK_JUMP"
"""The ground's clock, which timestamps arrivals, was set; the device's clock was not affected."""
DAMAGE = ("bad_crc", "too_long", "too_short")


@dataclass(frozen=True)
class HousekeepingSample:
    """One housekeeping packet: time of arrival (Unix seconds), device clock in it, uptime, contact."""

    at_s: float
    device_time_s: float
    uptime_s: float | None = None
    contact_id: int | None = None


@dataclass(frozen=True)
class Count:
    """Receive counters of a contact at a given time: gaps, bad_crc, too_long, too_short, good …"""

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
    """A gap between two samples. ``missing``: number of missing packets; 0 if all were received but late."""

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
    """Numbers of expected and stored packets, and each gap. ``late``: spans whose packets are complete but arrived late."""

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
        """Share of the expected packets that are stored; 1 for an empty record."""
        return self.held / self.expected if self.expected else 1.0


def check_record(
    samples: Sequence[HousekeepingSample],
    counts: Sequence[Count],
    happenings: Sequence[Happening],
    *,
    start_s: float | None = None,
    end_s: float | None = None,
) -> RecordCheck:
    """Check the unsolicited samples of a record, in order of time. If ``start_s`` and ``end_s`` of the contact are given,
    the time before the first and after the last sample is checked too."""
    gaps: list[Gap] = []
    late: list[Gap] = []
    evidence = _Evidence(counts, happenings)
    period_s = _period_s(samples)
    for before, after in itertools.pairwise(samples):
        gaps_between = _between(before, after, evidence, period_s)
        if gaps_between is not None:
            (gaps if gaps_between.missing else late).append(gaps_between)
    gaps += _ends(samples, evidence, start_s, end_s, period_s)
    gaps.sort(key=lambda gap: gap.from_s)
    present = len(samples)
    return RecordCheck(present + sum(gap.missing for gap in gaps), present, tuple(gaps), tuple(late))


def why_silent(
    from_s: float, to_s: float, counts: Sequence[Count], happenings: Sequence[Happening], contact_id: int | None
) -> str:
    """Return the reason why no good packet was received in a span of a contact."""
    evidence = _Evidence(counts, happenings)
    lost, boot = evidence.happened((LINE_LOST,), to_s, to_s), evidence.happened(RESETS, from_s, to_s)
    if lost is not None:
        return f"the line was lost ({lost.text})"
    if boot is not None:
        return "the device restarted" + (f" ({boot.text})" if boot.text else "")
    return evidence.cause(from_s, to_s, contact_id)


class _Evidence:
    """Counters and events that can explain a gap."""

    def __init__(self, counts: Sequence[Count], happenings: Sequence[Happening]) -> None:
        self._counts, self._happenings = counts, happenings

    def happened(self, names: Sequence[str], from_s: float, to_s: float) -> Happening | None:
        """Return the first event of these names within a span."""
        return next(
            (h for h in self._happenings if h.name in names and from_s - SLACK_S <= h.at_s <= to_s + SLACK_S), None
        )

    def risen(self, from_s: float, to_s: float, contact_id: int | None) -> dict[str, float]:
        """Return the increase of each counter of a contact over a span: from the last count before it to the first one after
        it."""
        counts = [c for c in self._counts if c.contact_id == contact_id]
        before = next((c.values for c in reversed(counts) if c.at_s <= from_s), {})
        after = next((c.values for c in counts if c.at_s >= to_s), counts[-1].values if counts else {})
        return {name: value - before.get(name, 0) for name, value in after.items()}

    def cause(self, a_s: float, b_s: float, contact_id: int | None) -> str:
        """Return the reason why packets of a span are missing."""
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
    """Return the device's housekeeping period: the median step of its clock, at most ``PERIOD_S``."""
    steps = sorted(
        b.device_time_s - a.device_time_s
        for a, b in itertools.pairwise(samples)
        if a.contact_id == b.contact_id and b.device_time_s > a.device_time_s
    )
    return min(PERIOD_S, steps[len(steps) // 2]) if len(steps) >= MIN_STEPS else PERIOD_S


def _between(before: HousekeepingSample, after: HousekeepingSample, evidence: _Evidence, period_s: float) -> Gap | None:
    """Return the gap between two neighbouring samples; None if there is none."""
    if before.contact_id != after.contact_id:
        missing = max(0, round((after.at_s - before.at_s) / period_s) - 1)
        return Gap(before.at_s, after.at_s, missing, "the line was closed meanwhile") if missing else None
    on_board_s, here_s = after.device_time_s - before.device_time_s, after.at_s - before.at_s
    restarted = after.uptime_s is not None and before.uptime_s is not None and after.uptime_s < before.uptime_s
    if here_s < -SLACK_S or evidence.happened((GROUND_CLOCK,), after.at_s - SLACK_S, after.at_s) is not None:
        missing = max(0, round(on_board_s / period_s) - 1)  # the ground's clock jumped: use the device's
        lost = missing and not restarted and on_board_s > GAP_PERIODS * period_s
        return (
            Gap(before.at_s, after.at_s, missing, evidence.cause(after.at_s, after.at_s, before.contact_id))
            if lost
            else None
        )
    boot = evidence.happened(RESETS, before.at_s, after.at_s)
    clock = evidence.happened(CLOCKS, before.at_s, after.at_s)
    if restarted or clock is not None or on_board_s <= 0:
        missing = max(0, round(here_s / period_s) - 1)  # the device's clock was set: use the ground's
        if here_s <= GAP_PERIODS * period_s or not missing:
            return None
        if restarted:
            detail = f" ({boot.text})" if boot is not None and boot.text else ""
            return Gap(before.at_s, after.at_s, missing, f"the device restarted{detail}")
        return Gap(before.at_s, after.at_s, missing, evidence.cause(before.at_s, after.at_s, before.contact_id))
    if on_board_s > GAP_PERIODS * period_s:
        missing = max(1, round(on_board_s / period_s) - 1)
        return Gap(before.at_s, after.at_s, missing, evidence.cause(before.at_s, after.at_s, before.contact_id))
    if here_s > LATE_S:
        return Gap(before.at_s, after.at_s, 0, "received late: the line stalled, nothing is missing")
    return None


def _ends(
    samples: Sequence[HousekeepingSample],
    evidence: _Evidence,
    start_s: float | None,
    end_s: float | None,
    period_s: float,
) -> list[Gap]:
    """Return the gaps between opening the line and the first sample, and between the last one and closing it."""
    if not samples:
        if start_s is None or end_s is None or end_s - start_s <= LATE_S:
            return []
        missing = round((end_s - start_s) / period_s)
        return [Gap(start_s, end_s, missing, f"{UNEXPLAINED}: no packet received")]
    gaps = []
    first, last = samples[0], samples[-1]
    if start_s is not None and first.at_s - start_s > LATE_S:
        missing = round((first.at_s - start_s) / period_s)
        young = first.uptime_s is not None and first.uptime_s < first.at_s - start_s
        cause = "the device was not running yet" if young else evidence.cause(start_s, first.at_s, first.contact_id)
        gaps.append(Gap(start_s, first.at_s, missing, cause))
    if end_s is not None and end_s - last.at_s > LATE_S:
        missing = round((end_s - last.at_s) / period_s)
        cause = evidence.cause(last.at_s, end_s, last.contact_id)
        closed = evidence.happened((LINE_LOST,), end_s, end_s)
        if closed is not None:
            cause = f"the line was lost ({closed.text})"
        elif cause == UNEXPLAINED:
            cause = f"{UNEXPLAINED}: no data until the line was closed"
        gaps.append(Gap(last.at_s, end_s, missing, cause))
    return gaps
