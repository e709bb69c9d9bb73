"""A state changes only after consecutive samples, and contradictory limits are rejected."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gss.domain.errors import BadInput
from gss.domain.limits import ORDER, Limits, Persistence, State, worst

STATES = st.sampled_from(list(State))
RUNS = st.lists(STATES, max_size=60)
PERSISTENCES = st.integers(1, 6)


def counted(samples: list[State], n: int, start: Persistence | None = None) -> list[State]:
    """Return the persistent state after each sample."""
    run, states = start or Persistence(), []
    for sample in samples:
        run = run.after(sample, n)
        states.append(run.counted)
    return states


@given(RUNS, PERSISTENCES)
def test_a_rise_needs_n_samples_at_least_that_bad_and_a_fall_n_samples_no_worse(samples, n):
    """The state rises if the last n samples are at least as bad as the new state, and falls if none of them is worse."""
    before = State.OK
    for k, now in enumerate(counted(samples, n)):
        last = samples[max(0, k + 1 - n) : k + 1]
        if now != before:
            assert len(last) == n
        if ORDER[now] > ORDER[before]:
            assert all(ORDER[s] >= ORDER[now] for s in last)
            assert now in last
        elif ORDER[now] < ORDER[before]:
            assert all(ORDER[s] <= ORDER[now] for s in last)
            assert now in last
        before = now


@given(RUNS, STATES, PERSISTENCES)
def test_n_equal_samples_set_the_state(samples, state, n):
    """After n samples with the same state, that is the persistent state, whatever the previous samples were."""
    assert counted([*samples, *[state] * n], n)[-1] is state


@given(RUNS, PERSISTENCES)
def test_fewer_than_n_samples_change_nothing(samples, n):
    """A spike shorter than the persistence, between normal samples, never changes the state."""
    spike = [s for s in samples if s is not State.OK][: n - 1]
    assert set(counted([*[State.OK] * n, *spike, *[State.OK] * n], n)) == {State.OK}


@given(RUNS)
def test_with_persistence_one_every_sample_counts(samples):
    """With n = 1 the persistent state is that of each sample."""
    assert counted(samples, 1) == samples


@given(RUNS, PERSISTENCES)
def test_memory_is_bounded_by_the_persistence(samples, n):
    """A persistence of n samples stores at most n − 1 of them."""
    run = Persistence()
    for sample in samples:
        run = run.after(sample, n)
        assert len(run.recent) <= n - 1


def test_a_missing_sample_resets_the_count_but_not_the_alarm():
    """Two violations, a missing sample and a violation are not three in a row. An active alarm remains active."""
    run = Persistence().after(State.WARNING, 3).after(State.WARNING, 3).broken().after(State.WARNING, 3)
    assert run.counted is State.OK
    assert Persistence(State.CRITICAL, (State.OK,)).broken() == Persistence(State.CRITICAL)


def test_a_persistence_below_one_is_rejected():
    """A persistence of zero samples is rejected."""
    with pytest.raises(BadInput, match="persistence"):
        Persistence().after(State.OK, 0)


@pytest.mark.parametrize(
    "limits",
    [
        Limits(watch=(5, 4)),
        Limits(watch=(0, 20), warning=(0, 10)),
        Limits(watch=(-1, 5), critical=(0, 10)),
        Limits(warning=(None, 12), critical=(None, 10)),
        Limits(watch=(float("nan"), None)),
    ],
)
def test_contradictory_limits_are_rejected(limits):
    """An empty range, and a lower severity whose range extends beyond that of a higher one, are rejected."""
    with pytest.raises(BadInput):
        limits.checked()


def test_nested_and_one_sided_limits_are_accepted():
    """Equal bounds and missing levels are accepted."""
    for limits in (
        Limits(),
        Limits((0, 10), (0, 10), (-5, 10)),
        Limits(critical=(None, 0)),
        Limits((1, None), (0, None)),
    ):
        assert limits.checked() is limits
    assert not Limits().any
    assert Limits(critical=(None, 0)).any
    assert worst([]) is State.OK
