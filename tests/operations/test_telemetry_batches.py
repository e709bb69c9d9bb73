"""Packets processed in a batch give the same rows, limit checks and alarms as packets processed one by one."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path
from typing import Any

from sqlalchemy import text

from gss.device.protocol.codec import decode, encode
from gss.device.protocol.packet import Arrival
from gss.device.session_events import Telemetry
from gss.domain.limits import Limits
from gss.instruments.dictionary.definitions import Group, TelemetryField
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.roles import default_roles
from gss.operations.events import EventBus
from gss.operations.line.dispatcher import LineEventQueue
from gss.operations.line.line_events import LineBatch
from gss.operations.line.link import LinkService
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.limit_book import LimitBook
from gss.operations.telemetry.limit_check import Judgement
from gss.operations.telemetry.telemetry import TelemetryBoard, TelemetryService
from gss.store.engine import Database, open_engine
from gss.store.migration import migrate
from gss.store.models import Alarm

DICTIONARY = load_dictionary()
STATUS = default_roles(DICTIONARY).quantities.status
NAMES = ("housekeeping", "housekeeping", "housekeeping", "timing", "attitude", "centroids")


class BatchHarness:
    """Telemetry and alarms on a separate database, without a link."""

    def __init__(self, folder: Path, clock: Any) -> None:
        folder.mkdir()
        url = f"sqlite:///{folder / 'gss.db'}"
        migrate(url)
        self.database = Database(open_engine(url))
        bus = EventBus(self.database, clock)
        link = LinkService(
            DICTIONARY,
            default_roles(DICTIONARY),
            self.database,
            bus,
            folder,
            clock,
            lambda: 0.0,
            LineEventQueue(clock, lambda: 0.0),
        )
        self.telemetry = TelemetryService(
            DICTIONARY,
            self.database,
            bus,
            clock,
            lambda: None,
            lambda: True,
            default_roles(DICTIONARY).quantities.status,
        )
        self.alarms = AlarmService(DICTIONARY, self.telemetry, link, self.database, bus, clock)
        self.judgements: list[Judgement] = []
        self._clock = clock

    def receive(self, *packets: Telemetry) -> None:
        """Process a batch like the dispatcher."""
        batch = LineBatch(packets, self._clock(), 0.0)
        derived = self.telemetry.handle(batch)
        self.judgements += [judgement for event in derived for judgement in event.judgements]
        self.alarms.handle(batch.with_derived(derived))

    def rows(self, table: str) -> list[tuple[Any, ...]]:
        """Return the stored bytes of a table."""
        with self.database.unit_of_work() as session:
            return [tuple(row) for row in session.execute(text(f"select * from {table} order by 1"))]  # noqa: S608


def packets(count: int, seed: int) -> list[Telemetry]:
    """Simulate a sensor that runs, pauses and runs again, with occasional limit violations, not-a-number values and
    lists, encoded and decoded as on the link.
    """
    rng, simulated = random.Random(seed), []
    for k in range(count):
        name = rng.choice(NAMES)
        definition = DICTIONARY.packet(name)
        iteration = {"cycle_running": not 20 < k % 50 < 30, "iteration": 100 + k // 50}
        values = {f.name: iteration.get(f.name, random_value(f, rng, k)) for f in definition.values}
        lists = {
            group.name: tuple({i.name: random_value(i, rng, k) for i in group.items} for _ in range(k % 3))
            for group in definition.fields
            if isinstance(group, Group)
        }
        message = decode(definition.fields, encode(definition.fields, values, lists))
        simulated.append(Telemetry(name, float(k), k % 2, message.raw, message.values, message.lists))
    return simulated


def random_value(item: Any, rng: random.Random, k: int) -> Any:
    """Return a value within limits, outside them for several packets, or sometimes unknown."""
    if item.type == "bool":
        return rng.random() < 0.5
    if item.type == "enum":
        return rng.choice(item.choices).name
    if item.type in ("bytes", "str", "text"):
        return rng.randbytes(item.size) if item.type == "bytes" else "x"
    inside = 0.0
    if isinstance(item, TelemetryField):
        low, high = item.limits.watch
        inside = (low or 0.0) if high is None else high if low is None else (low + high) / 2
    if item.type in ("f32", "f64"):
        out = (hash_of(item.name) + k // 7) % 11 == 0
        return rng.choice([1e6, -1e6]) if out else rng.choice([inside, inside, inside, float("nan"), float("inf")])
    return 0 if isinstance(item, TelemetryField) and item.conversion.coefficients else int(min(max(inside, 0), 100))


def hash_of(name: str) -> int:
    """Return a hash that is the same in every process."""
    return sum(map(ord, name))


def test_packets_processed_together_equal_those_processed_one_by_one(tmp_path: Path, clock: Any) -> None:
    """Stored telemetry, alarms and events and the latest values are equal for packets processed in batches and one by one."""
    received = packets(144, seed=3)
    one, many = BatchHarness(tmp_path / "one", clock), BatchHarness(tmp_path / "many", clock)
    for packet in received:
        one.receive(packet)
    for k in range(0, len(received), 48):
        many.receive(*received[k : k + 48])
    assert len(one.rows("telemetry_packets")) == len(received)
    assert len(one.rows("alarms")) > 5
    for table in ("telemetry_packets", "alarms", "events"):
        assert one.rows(table) == many.rows(table), table
    assert repr(one.telemetry.values()) == repr(many.telemetry.values())
    for harness in (one, many):
        harness.database.close()


def test_skipping_normal_values_gives_the_same_judgements(database: Database, bus: EventBus, clock: Any) -> None:
    """A board that skips normal values gives the same judgement of every value as one that judges each sample, also
    after changes of limits and restarts. It skips only normal judgements.
    """
    book = LimitBook(DICTIONARY, database, bus, clock)
    quick, thorough = (
        TelemetryBoard(DICTIONARY, book.rule, {}, STATUS),
        TelemetryBoard(DICTIONARY, book.rule, Everything(), STATUS),
    )
    book.subscribe(quick.limits.limits_changed)
    book.subscribe(thorough.limits.limits_changed)
    left_out = followed = 0
    for k, packet in enumerate(packets(220, seed=8)):
        if k == 80:
            book.override("housekeeping.sensor_temperature_c", Limits(watch=(-1.0, 1.0)), 2, user="ann")
        if k == 140:
            book.choose("commissioning", user="ann")
        thorough.limits._reset_fast_path()
        expected, reported = thorough.take(packet, clock()), quick.take(packet, clock())
        assert repr(quick.values(clock())) == repr(thorough.values(clock())), k
        omitted = [j for j in expected if j not in reported]
        assert [j for j in expected if j in reported] == reported
        assert all(j.state == "ok" for j in omitted)
        left_out, followed = left_out + len(omitted), followed + len(reported)
    assert left_out > followed > 100, (left_out, followed)


def test_a_field_with_an_open_alarm_is_reported_while_it_is_normal(
    database: Database, bus: EventBus, clock: Any
) -> None:
    """A normal value is reported if its field has an open alarm."""
    book = LimitBook(DICTIONARY, database, bus, clock)
    alarms: dict[tuple[str, str], Alarm] = {}
    board = TelemetryBoard(DICTIONARY, book.rule, alarms, STATUS)
    fields = {"sensor_temperature_c": 20.0, "cycle_running": True}
    packet = Telemetry("housekeeping", 1.0, 0, fields, fields)
    for _ in range(5):
        board.take(packet, clock())
    assert board.take(packet, clock()) == []
    alarms["housekeeping", "sensor_temperature_c"] = Alarm(id=7)
    (judgement,) = board.take(packet, clock())
    assert (judgement.field.name, judgement.value, judgement.state) == ("sensor_temperature_c", 20.0, "ok")
    assert [v.name for v in board.values(clock()) if v.alarm_id == 7] == ["sensor_temperature_c"]


class Everything(dict[tuple[str, str], Alarm]):
    """Open alarms of every field, none of which has a row."""

    def __contains__(self, key: object) -> bool:
        return True


def test_old_packets_do_not_become_current_values(tmp_path: Path, clock: Any) -> None:
    """A late packet is stored and not displayed, and a repeated one is only counted. One warning reports both."""
    harness = BatchHarness(tmp_path / "room", clock)
    first, second, third, *_ = [p for p in packets(200, 5) if p.packet == "housekeeping"]
    harness.receive(first, third)
    before = harness.telemetry.values()
    harness.receive(replace(second, arrival=Arrival.LATE), replace(first, arrival=Arrival.REPEATED))
    assert harness.telemetry.latest_packet("housekeeping") is third
    assert [v.value for v in harness.telemetry.values()] == [v.value for v in before]
    assert len(harness.rows("telemetry_packets")) == 3
    assert harness.telemetry.old == 2
    warnings = [row for row in harness.rows("events") if "older than the latest" in str(row)]
    assert len(warnings) == 1
    assert "2 telemetry packets" in str(warnings[0])


def test_only_a_packet_that_the_database_rejects_is_lost(tmp_path: Path, clock: Any) -> None:
    """A packet with a value that the database cannot hold is counted and stated by one event. The others are stored."""
    ground = BatchHarness(tmp_path / "rejected", clock)
    for n in range(2):
        first, second, third, *_ = [p for p in packets(60, n) if p.packet == "timing"]
        ground.receive(first, replace(second, request_id=10**30), third)
    assert len(ground.rows("telemetry_packets")) == 4
    assert (ground.telemetry.unstored, ground.telemetry.store_fails) == (2, "")
    assert sum("is in the raw capture only" in str(row) for row in ground.rows("events")) == 1
    ground.database.close()


def test_stored_packets_reach_the_disk_once_a_second(tmp_path: Path, clock: Any, monkeypatch: Any) -> None:
    """Telemetry is committed durably once per second, so that a power failure loses at most one second of rows."""
    ground = BatchHarness(tmp_path / "one", clock)
    durable: list[bool] = []
    begin = ground.database.unit_of_work

    def unit_of_work(**options: bool) -> Any:
        durable.append(options.get("durable", True))
        return begin(**options)

    monkeypatch.setattr(ground.database, "unit_of_work", unit_of_work)
    for n, at_s in enumerate((10.0, 10.2, 10.9, 11.0, 11.5, 12.1)):
        durable.clear()
        ground.telemetry.handle(LineBatch(tuple(packets(1, n)), clock(), at_s))
        assert durable[-1] is (at_s in (10.0, 11.0, 12.1))
    ground.database.close()
