"""Comparison of the heads of a spacecraft: agreement, misalignment, alarms, history, and unknown states."""

from __future__ import annotations

import json
import threading
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest
from sqlalchemy import func, select

from gss.domain.angles import ARCSEC_RAD
from gss.domain.errors import Conflict, GssError, NotFound
from gss.domain.limits import State
from gss.domain.rotation import quaternion_from_matrix, quaternion_inverse, quaternion_product, rotation_x, turned
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.roles import default_roles
from gss.operations.heads import head_watch
from gss.operations.heads.head_watch import HeadWatch, estimate_of
from gss.operations.heads.mountings import SpacecraftRequest
from gss.operations.heads.spacecraft_book import SpacecraftBook
from gss.operations.line.dispatcher import LineEventQueue
from gss.operations.line.link import LinkService
from gss.operations.requests import request_from
from gss.operations.telemetry.alarm_text import HEADS
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.last_attitude import AttitudeSample
from gss.operations.telemetry.telemetry import TelemetryService
from gss.store import heads as store
from gss.store.models import FusedRow

SIGMAS = {"A": (5.0, 40.0), "B": (6.0, 50.0)}
HEAD_A = {"unit": "A", "mounting_deg": [0.0, 0.0, 0.0]}
HEAD_B = {"unit": "B", "mounting_deg": [90.0, 0.0, 0.0], "sigma_arcsec": 5.0}


def request(**values: Any) -> SpacecraftRequest:
    return request_from(SpacecraftRequest, {"name": "SAT", "heads": [HEAD_A, HEAD_B], "tolerance_s": 2.0} | values)


@pytest.fixture
def book(database, bus, clock) -> SpacecraftBook:
    return SpacecraftBook(database, bus, clock)


@pytest.fixture
def alarms(database, bus, clock, tmp_path) -> AlarmService:
    dictionary = load_dictionary()
    link = LinkService(
        dictionary,
        default_roles(dictionary),
        database,
        bus,
        tmp_path,
        clock,
        lambda: 0.0,
        LineEventQueue(clock, lambda: 0.0),
    )
    telemetry = TelemetryService(
        dictionary, database, bus, clock, lambda: None, lambda: True, default_roles(dictionary).quantities.status
    )
    return AlarmService(dictionary, telemetry, link, database, bus, clock)


@pytest.fixture
def watch(book, database, alarms, clock) -> HeadWatch:
    return HeadWatch(book, database, alarms, clock)


class Body:
    """Rotating body with two heads that report alternately. ``misalignment_rad``: of head B, in body axes."""

    def __init__(self, watch: HeadWatch, clock: Any) -> None:
        self.watch, self.clock = watch, clock
        self.misalignment_rad = np.zeros(3)
        self.mountings = {"A": np.array([0, 0, 0, 1.0]), "B": quaternion_from_matrix(rotation_x(np.pi / 2).T)}
        self._rng = np.random.default_rng(5)

    def sample(self, unit: str, time_s: float, **values: Any) -> AttitudeSample:
        body = turned(np.array([0, 0, 0, 1.0]), np.array([0, -1e-3, 5e-4]) * (time_s % 1e4))
        mounting = self.mountings[unit] if unit == "A" else turned(self.mountings[unit], self.misalignment_rad)
        cross, roll = SIGMAS[unit]
        noise = self._rng.normal(size=3) * np.array([cross, cross, roll]) * ARCSEC_RAD
        x, y, z, w = turned(quaternion_product(quaternion_inverse(mounting), body), noise)
        at = datetime.fromtimestamp(time_s, UTC)
        defaults = {"source": "on board", "sigma_cross_arcsec": cross, "sigma_roll_arcsec": roll, "utc_sigma_s": 0.0}
        return AttitudeSample(quaternion=(x, y, z, w), utc=at, **(defaults | values))

    def run(self, seconds: int, units: str = "AB") -> None:
        for _ in range(seconds):
            now_s = self.clock().timestamp()
            for unit, phase_s in zip(units, (0.0, 0.37), strict=False):
                self.watch.take(unit, [self.sample(unit, now_s + phase_s)])
            self.clock.forward(1.0)
            self.watch.step()


@pytest.fixture
def body(watch, clock) -> Body:
    return Body(watch, clock)


def open_heads(alarms: AlarmService) -> list[tuple[str, str, str]]:
    return [(v.row.field, str(v.level), v.row.state) for v in alarms.opened() if v.row.packet == HEADS]


def test_heads_that_agree_are_fused(book, watch, body) -> None:
    """Attitudes of a rotating body at different times agree, and fusion gives all three angles within a few arcseconds."""
    book.create(request(), user="kim")
    body.run(40)
    (state,) = watch.states()
    assert state.verdict.state is State.OK
    assert state.result is not None
    assert not state.result.missing
    assert np.sqrt(np.diag(state.result.fused.covariance_rad2)).max() < 8 * ARCSEC_RAD
    truth = turned(np.array([0, 0, 0, 1.0]), np.array([0, -1e-3, 5e-4]) * (state.result.time_s % 1e4))
    assert np.linalg.norm(quaternion_product(state.result.fused.quaternion, quaternion_inverse(truth))[:3]) < 1e-4


def test_misalignment_raises_the_alarm_until_the_mounting_is_corrected(book, watch, body, alarms) -> None:
    """A misalignment of 60″ is measured within its uncertainty and raises the alarms of agreement and limit. With a
    corrected mounting the heads agree again."""
    setup = book.create(request(misalignment_limit_arcsec=30.0), user="kim")
    body.misalignment_rad = np.array([60.0, 0, 0]) * ARCSEC_RAD
    body.run(60)
    (state,) = watch.states()
    assert state.verdict.state is State.WARNING
    (pair,) = state.result.pairs
    assert np.all(np.abs(pair.misalignment.vector_rad - body.misalignment_rad) < 3.5 * pair.sigma_rad)
    assert open_heads(alarms) == [
        ("SAT: agreement", "warning", "raised"),
        ("SAT: B misalignment", "warning", "raised"),
    ]
    texts = [view.text for view in alarms.opened() if view.row.packet == HEADS]
    assert [text.partition(" by ")[0] for text in texts] == ["SAT: A and B differ", "SAT: B is misaligned"]
    watch.correct(setup.id, "B", user="kim")
    body.run(40)
    (state,) = watch.states()
    assert state.verdict.state is State.OK
    assert {alarm[1:] for alarm in open_heads(alarms)} == {("ok", "cleared")}
    assert np.linalg.norm(state.result.pairs[0].misalignment.vector_rad) < 15 * ARCSEC_RAD
    with pytest.raises(Conflict, match="no current misalignment"):
        watch.correct(setup.id, "A", user="kim")


def test_one_head_alone_is_unknown(book, watch, body, alarms, clock) -> None:
    """If the other head is silent, the agreement is unknown and no alarm changes. If both are silent, there is no
    attitude."""
    book.create(request(stale_s=5.0), user="kim")
    watch.step()
    assert watch.states()[0].verdict.state is None
    body.run(10)
    body.run(10, "A")
    (state,) = watch.states()
    assert state.verdict.state is None
    assert "Only A reports; B is silent" in state.verdict.text
    assert state.result.fused.agreement is None
    assert state.result.missing == {"B": "silent"}
    assert state.result.pairs == ()
    clock.forward(60)
    watch.step()
    text = watch.states()[0].verdict.text
    assert "No head has an attitude from its sensor of the last 5 s; the latest is 6" in text
    assert open_heads(alarms) == []


def test_an_attitude_without_sigma_is_rejected_with_the_reason(book, watch, body, clock) -> None:
    """A head whose sensor reports no standard deviations is used only if the spacecraft states them."""
    book.create(request(), user="kim")
    watch.step()
    unknown = {"sigma_cross_arcsec": None, "sigma_roll_arcsec": None}
    for k in range(3):
        at_s = clock().timestamp() + k
        watch.take("A", [body.sample("A", at_s)])
        watch.take("B", [body.sample("B", at_s, **unknown)])
    clock.forward(4)
    watch.step()
    (state,) = watch.states()
    assert "no valid standard deviations" in state.result.missing["B"]
    assert "no valid standard deviations" in state.verdict.text
    stated = HEAD_B | {"sigma_cross_arcsec": 6.0, "sigma_roll_arcsec": 50.0}
    book.change(state.setup.id, request(heads=[HEAD_A, stated]), user="kim")
    watch.refresh()
    for k in range(3):
        at_s = clock().timestamp() + k
        watch.take("A", [body.sample("A", at_s)])
        watch.take("B", [body.sample("B", at_s, **unknown), body.sample("B", at_s + 0.5, source="ground")])
    clock.forward(4)
    watch.step()
    assert set(watch.states()[0].result.attitudes) == {"A", "B"}


@pytest.mark.parametrize("sigmas", [(1e-20, 1e20), (1e200, 1e200), (1e-300, 40.0), (float("nan"), 40.0)])
def test_impossible_sigmas_of_a_faulty_sensor_do_not_stop_the_comparison(
    book, watch, body, clock, sigmas: tuple[float, float]
) -> None:
    """A head with invalid standard deviations is excluded and named in the text. The other head is used."""
    book.create(request(), user="kim")
    watch.step()
    faulty = {"sigma_cross_arcsec": sigmas[0], "sigma_roll_arcsec": sigmas[1]}
    for k in range(3):
        at_s = clock().timestamp() + k
        watch.take("A", [body.sample("A", at_s)])
        watch.take("B", [body.sample("B", at_s, **faulty)])
    clock.forward(4)
    watch.step()
    (state,) = watch.states()
    assert set(state.result.attitudes) == {"A"}
    assert np.isfinite(state.result.fused.quaternion).all()
    assert "B: the sensor reports no valid standard deviations" in state.verdict.text


@pytest.mark.parametrize(
    "values", [{"name": " \t "}, {"name": "SAT\x1b[2J"}, {"heads": [HEAD_A | {"unit": "A\u202e"}]}]
)
def test_unprintable_names_are_rejected(book, values: dict[str, Any]) -> None:
    """Names with control characters, which would reach terminals of other users, are rejected."""
    with pytest.raises(GssError, match="name contains unprintable"):
        book.create(request(**values), user="kim")


def test_the_text_states_why_attitudes_cannot_be_compared(book, watch, body, clock) -> None:
    """The text states what each head lacks: standard deviations, a rate, or an attitude near that of the other head. An
    unusable reference head does not exclude the others."""
    setup = book.create(request(stale_s=60.0), user="kim")
    watch.step()

    def shown(values: dict[str, Any], *samples: tuple[str, float, dict[str, Any]]) -> str:
        book.change(setup.id, request(**{"stale_s": 60.0} | values), user="kim")
        watch.refresh()
        clock.forward(100)
        watch.step()
        now_s = clock().timestamp()
        for unit, at_s, sample_values in samples:
            watch.take(unit, [body.sample(unit, now_s + at_s, **sample_values)])
        clock.forward(9)
        watch.step()
        return watch.states()[0].verdict.text

    unknown = {"sigma_cross_arcsec": None, "sigma_roll_arcsec": None}
    text = shown({}, ("A", 0, unknown), ("B", 0, unknown), ("A", 1, unknown), ("B", 1, unknown))
    assert "cannot be compared. A: the sensor reports no valid standard deviations" in text
    assert "; B: the sensor reports no valid standard deviations" in text
    text = shown({}, ("A", 0, unknown), ("B", 0, {}), ("A", 1, unknown), ("B", 1, {}))
    assert "Only one head could be used. A: the sensor reports no valid standard deviations" in text
    assert "B: its rate is unknown" in shown({}, ("A", 0, {}), ("A", 1, {}), ("A", 2, {}), ("B", 2.5, {}))
    text = shown({}, ("A", 0, {}), ("A", 1, {}), ("B", 5, {}), ("B", 6, {}))
    assert "B: its nearest attitude is 4.0 s from the other's, the tolerance is 2 s" in text


def test_history_is_stored_and_continued(book, watch, body, database, alarms, clock) -> None:
    """Comparisons are stored every ten seconds. After a restart the estimate continues from the newest one. When the
    spacecraft is removed, its alarms are cleared."""
    setup = book.create(request(), user="kim")
    body.misalignment_rad = np.array([90.0, 0, 0]) * ARCSEC_RAD
    begun = clock()
    body.run(60)
    with database.unit_of_work() as session:
        rows = store.pairs_between(session, setup.id, begun, clock(), 100)
        limited = store.pairs_between(session, setup.id, begun, clock(), 3)
        fused = session.scalar(select(func.count()).select_from(FusedRow))
    assert (fused, len(rows), len(limited)) == (6, 5, 2)  # at the first time the rate of head B was unknown
    assert np.allclose(np.diag(estimate_of(rows[-1]).covariance), np.array(rows[-1].covariance)[[0, 6, 11, 15, 18, 20]])
    restarted = HeadWatch(book, database, alarms, clock)
    body.watch = restarted
    body.run(8)
    (pair,) = restarted.states()[0].result.pairs
    assert pair.misalignment.samples > rows[-1].samples
    assert open_heads(alarms)
    book.remove(setup.id, user="kim")
    restarted.refresh()
    restarted.step()
    assert restarted.states() == []
    assert {alarm[1:] for alarm in open_heads(alarms)} == {("ok", "cleared")}


@pytest.mark.parametrize("restarted", [False, True])
def test_the_comparison_continues_after_the_clock_is_set_back(
    book, watch, body, database, alarms, clock, restarted: bool
) -> None:
    """If the clock is set back by an hour, the estimate of the misalignment continues at the new time, also after a
    restart, and the duration of the estimate does not change."""
    book.create(request(misalignment_limit_arcsec=60.0), user="kim")
    body.run(60)
    (before,) = watch.states()[0].result.pairs
    clock.forward(-3600)
    if restarted:
        body.watch = HeadWatch(book, database, alarms, clock)
    body.misalignment_rad = np.array([300.0, 0, 0]) * ARCSEC_RAD
    body.run(30)
    (state,) = body.watch.states()
    (after,) = state.result.pairs
    assert abs(clock().timestamp() - after.misalignment.time_s) < 3
    assert after.misalignment.began_s <= after.misalignment.time_s
    assert after.misalignment.restarts == before.misalignment.restarts + 1
    assert ("SAT: B misalignment", "warning", "raised") in open_heads(alarms)


def test_times_that_wait_are_forgotten_when_the_clock_is_set_back(book, watch, body, clock) -> None:
    """A time that waits for the other head does not delay the comparison after the clock is set back."""
    book.create(request(), user="kim")
    body.run(10)
    watch.take("A", [body.sample("A", clock().timestamp() + 0.5)])
    watch.step()
    clock.forward(-3600)
    body.run(10)
    (state,) = watch.states()
    assert abs(clock().timestamp() - state.result.time_s) < 3


def test_an_unexpected_error_does_not_end_the_thread(watch, monkeypatch) -> None:
    """After an error of any type, the problem is stated and the next step is executed."""
    repeated = threading.Event()
    steps = iter(range(1000))

    def fail() -> None:
        if next(steps):
            repeated.set()
        raise RuntimeError("a damaged row")

    monkeypatch.setattr(head_watch, "TICK_S", 0.01)
    monkeypatch.setattr(watch, "step", fail)
    watch.start()
    assert repeated.wait(5)
    watch.stop()
    assert watch.problem == "a damaged row"


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"heads": []}, "heads"),
        ({"heads": [HEAD_A, HEAD_A | {"unit": "a"}]}, "listed twice"),
        ({"heads": [{"unit": "A"}]}, "set either mounting_deg or body_from_cam"),
        ({"heads": [{"unit": "A", "body_from_cam": [0.0, 0.0, 0.5, 0.5]}]}, "length 1"),
        ({"heads": [HEAD_A | {"sigma_cross_arcsec": 5.0}]}, "both standard deviations"),
        ({"heads": [HEAD_A | {"mounting_deg": [0.0, float("nan"), 0.0]}]}, "heads, item 1.mounting_deg"),
        ({"tolerance_s": 0.0}, "tolerance_s"),
    ],
)
def test_invalid_values_are_rejected_with_their_names(values: dict[str, Any], words: str) -> None:
    """A request with an invalid value is rejected with its name and the expected value."""
    with pytest.raises(GssError, match=words):
        request(**values)


@pytest.mark.parametrize(
    ("heads", "words"),
    [
        ("[{", "heads: Input should be a valid list"),
        ("[]", "at least 1 item"),
        ('[{"unit": "C", "sigma_rad": 0.0}]', "heads.0.body_from_cam: Field required"),
        ('[{"unit": "C", "sigma_rad": 0.0, "body_from_cam": [0, 0, 0, 0]}]', "length 1"),
    ],
)
def test_a_damaged_row_is_named_and_does_not_affect_the_others(book, watch, body, database, heads, words) -> None:
    """A damaged spacecraft is listed with the reason. The others are compared, and it can be changed or deleted."""
    damaged = book.create(request(name="OTHER", heads=[HEAD_A | {"unit": "C"}]), user="kim")
    book.create(request(), user="kim")
    with database.engine.begin() as connection:
        connection.exec_driver_sql("UPDATE spacecraft SET heads = ? WHERE id = ?", (heads, damaged.id))
    assert [(s.name, len(s.heads), words in s.problem) for s in book.list_all()] == [
        ("OTHER", 0, True),
        ("SAT", 2, False),
    ]
    body.run(5)
    assert [(state.setup.name, state.result is not None) for state in watch.states()] == [("SAT", True)]
    assert book.change(damaged.id, request(name="OTHER", heads=[HEAD_A | {"unit": "C"}]), user="kim").problem == ""
    with database.engine.begin() as connection:
        connection.exec_driver_sql("UPDATE spacecraft SET heads = ? WHERE id = ?", (heads, damaged.id))
    book.remove(damaged.id, user="kim")
    assert [s.name for s in book.list_all()] == ["SAT"]


def test_names_and_units_are_used_once(book) -> None:
    """A name and a unit can be used by one spacecraft only. An unknown spacecraft is rejected. A mounting quaternion is
    equal to its angles."""
    first = book.create(request(), user="kim")
    with pytest.raises(Conflict, match="name exists"):
        book.create(request(name="sat", heads=[HEAD_A | {"unit": "C"}]), user="kim")
    with pytest.raises(Conflict, match="another spacecraft"):
        book.create(request(name="Other"), user="kim")
    with pytest.raises(NotFound):
        book.remove(first.id + 1, user="kim")
    quaternion = [float(q) for q in first.heads[1].body_from_cam]
    changed = book.change(first.id, request(heads=[HEAD_A, {"unit": "B", "body_from_cam": quaternion}]), user="kim")
    assert changed.heads[1].turns_deg == pytest.approx((90, 0, 0))
    assert changed.heads[1].boresight == pytest.approx([0, -1, 0], abs=1e-9)
    assert json.dumps(quaternion)
