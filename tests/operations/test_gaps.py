"""The record check states a cause for a gap only if other records prove this cause."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gss.operations.contacts.gaps import (
    CLOCK_SET,
    NOT_STORED,
    RESTARTED,
    Count,
    Happening,
    HousekeepingSample,
    check_record,
)


def steady(n: int, *, without=(), start: float = 1000.0) -> list[HousekeepingSample]:
    """Return one housekeeping sample for each of ``n`` seconds, except for the seconds ``without``."""
    return [HousekeepingSample(start + k, 50.0 + k, 10.0 + k, 1) for k in range(n) if k not in without]


def count(at: float, **values: float) -> Count:
    """Return a sample of the counters of contact 1."""
    return Count(at, {"gaps": 0, "bad_crc": 0, "too_long": 0, "too_short": 0} | values, 1)


@given(st.sets(st.integers(1, 58)))
def test_stored_and_missing_packets_add_up_to_those_sent(without):
    """Stored and missing packets add up to the sixty sent, whichever were lost."""
    check = check_record(steady(60, without=without), [], [])
    assert (check.expected, check.held) == (60, 60 - len(without))
    assert sum(gap.missing for gap in check.gaps) == len(without)
    assert len(check.unexplained) == len(check.gaps)


@pytest.mark.parametrize(
    ("counts", "cause"),
    [
        ([], "unexplained"),
        ([count(1000), count(1030)], "unexplained"),
        ([count(1000), count(1014, gaps=4)], "lost on the line: 4 packets missing by their sequence counts"),
        (
            [count(1000), count(1014, gaps=4, bad_crc=3)],
            "lost on the line: 4 packets missing by their sequence counts; 3 packets with a bad checksum",
        ),
        ([count(1000), count(1014, bad_crc=3)], "damaged on the line: 3 packets"),
        ([count(1000, gaps=7), count(1030, gaps=7)], "unexplained"),
        ([count(1000), count(1005, gaps=7), count(1009, gaps=7), count(1030, gaps=7)], "unexplained"),
        ([Count(1014, {"gaps": 9}, 2)], "unexplained"),
    ],
)
def test_counters_explain_only_gaps_of_their_time(counts, cause):
    """A counter that increases during a gap explains the gap. An increase before the gap or in another contact does not."""
    (gap,) = check_record(steady(30, without={10, 11, 12}), counts, []).gaps
    assert gap.missing == 3
    assert gap.cause.startswith(cause)
    assert gap.explained == (not cause.startswith("unexplained"))


def test_a_restart_a_set_clock_and_a_closed_link_are_causes():
    """The uptime shows a restart, an event shows that the clock was set, and a new contact shows a closed link."""
    before, after = steady(5), [HousekeepingSample(1012.0 + k, 3.0 + k, 1.0 + k, 1) for k in range(5)]
    check = check_record([*before, *after], [], [Happening(1010.0, RESTARTED, "watchdog")])
    assert [(g.missing, g.cause) for g in check.gaps] == [(7, "the device restarted (watchdog)")]
    jumped = [*steady(5), *(HousekeepingSample(1005.0 + k, 9000.0 + k, 15.0 + k, 1) for k in range(5))]
    assert check_record(jumped, [], [Happening(1004.5, CLOCK_SET)]).gaps == ()
    (gap,) = check_record(jumped, [], []).gaps
    assert not gap.explained
    second = [HousekeepingSample(1020.0, 70.0, 30.0, 2)]
    (gap,) = check_record([*steady(5), *second], [], []).gaps
    assert gap.cause == "the line was closed in this time"


def test_late_packets_are_not_missing():
    """If a line pauses for six seconds and then delivers all packets, there is no gap and one late span."""
    samples = [*steady(5), *(HousekeepingSample(1010.0 + 0.01 * k, 55.0 + k, 15.0 + k, 1) for k in range(6))]
    check = check_record(samples, [], [])
    assert (check.gaps, check.expected, check.share) == ((), 11, 1.0)
    assert len(check.late) == 1
    assert check.late[0].missing == 0


def test_gaps_at_the_ends_of_a_contact_are_found():
    """Gaps before the first packet and after the last one are found. A gap without a known cause is unexplained."""
    young = [HousekeepingSample(1010.0, 2.0, 1.0, 1)]
    (gap,) = check_record(young, [], [], start_s=1000.0, end_s=1011.0).gaps
    assert gap.cause == "the device was not running yet"
    check = check_record(steady(5), [], [], start_s=999.0, end_s=1020.0)
    assert [g.missing for g in check.unexplained] == [16]
    lost = check_record(steady(5), [], [Happening(1020.0, "LINE_LOST", "the cable is out")], start_s=999, end_s=1020.0)
    assert lost.unexplained == ()
    assert len(check_record([], [], [], start_s=0.0, end_s=60.0).unexplained) == 1
    assert check_record([], [], [], start_s=0.0, end_s=2.0).gaps == ()


def test_a_device_that_sends_fifty_times_a_second_misses_as_many_packets_as_it_sent():
    """The number of missing packets follows from the period of the device, not from the longest permitted period."""
    samples = [HousekeepingSample(1000.0 + k / 50, 50.0 + k / 50, 10.0, 1) for k in range(500) if not 100 <= k < 250]
    (gap,) = check_record(samples, [count(1000)], []).gaps
    assert gap.missing == 150


def test_packets_that_a_busy_device_sends_late_are_not_missing():
    """A long step of the device's clock is not a gap if shorter steps then make up for it. A step that
    remains is a gap."""
    steps = [0.02] * 60
    steps[30:33] = [0.032, 0.012, 0.016]
    for lost, gaps in (0.0, 0), (0.02, 1):
        times = [sum(steps[:k]) + (lost if k > 45 else 0.0) for k in range(len(steps))]
        check = check_record([HousekeepingSample(1000 + t, 50 + t, 10 + t, 1) for t in times], [], [])
        assert [gap.missing for gap in check.gaps] == [1] * gaps
        assert check.held == len(times)


def test_packets_that_the_server_could_not_store_were_not_lost_on_the_line():
    """If an event states that packets were not stored, this is the cause, even if sequence counts are missing too."""
    stored_again = Happening(
        1012.5, NOT_STORED, "telemetry is stored again; 3 earlier packets are in the raw capture only"
    )
    (gap,) = check_record(steady(30, without={10, 11, 12}), [count(1000), count(1014, gaps=4)], [stored_again]).gaps
    assert (gap.missing, gap.explained) == (3, True)
    assert gap.cause.startswith("not stored by the server: telemetry is stored again")
