"""Packets that queued up are handled together, and nothing shows it: rows, judgements and alarms are those of one by one."""

from __future__ import annotations

import random
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sqlalchemy import text

from gss.device.dictionary import Group, TelemetryField
from gss.device.dictionary_file import load_dictionary
from gss.device.protocol.codec import decode, encode
from gss.device.session_events import Telemetry
from gss.domain.limits import Limits
from gss.operations.events import EventBus
from gss.operations.line.line_events import LineBatch, LineEventQueue
from gss.operations.line.link import LinkService
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.limit_book import LimitBook
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.telemetry.telemetry_board import Judgement, TelemetryBoard
from gss.store.engine import Database, migrate, open_engine

DICTIONARY = load_dictionary()
NAMES = ("housekeeping", "housekeeping", "housekeeping", "timing", "attitude", "centroids")


class Room:
    """Telemetry and alarms on a database of their own, without a line."""

    def __init__(self, folder: Path, clock: Any) -> None:
        folder.mkdir()
        url = f"sqlite:///{folder / 'gss.db'}"
        migrate(url)
        self.database = Database(open_engine(url))
        bus = EventBus(self.database, clock)
        link = LinkService(
            DICTIONARY, self.database, bus, folder, clock, lambda: 0.0, LineEventQueue(clock, lambda: 0.0)
        )
        self.telemetry = TelemetryService(DICTIONARY, self.database, bus, clock, lambda: None, lambda: True)
        self.alarms = AlarmService(DICTIONARY, self.telemetry, link, self.database, bus, clock)
        self.judgements: list[Judgement] = []
        self._clock = clock

    def hear(self, *packets: Telemetry) -> None:
        """A batch as the dispatcher hands it on."""
        batch = LineBatch(packets, self._clock(), 0.0)
        derived = self.telemetry.handle(batch)
        self.judgements += [judgement for event in derived for judgement in event.judgements]
        self.alarms.handle(batch.with_derived(derived))

    def rows(self, table: str) -> list[tuple[Any, ...]]:
        """The bytes of a table as they were stored."""
        with self.database.unit_of_work() as session:
            return [tuple(row) for row in session.execute(text(f"select * from {table} order by 1"))]  # noqa: S608


def packets(count: int, seed: int) -> list[Telemetry]:
    """What a sensor that runs, rests and runs again might say, with values that leave their limits now and then, values that are
    not a number, and lists; through the codec, as from the line."""
    rng, found = random.Random(seed), []
    for k in range(count):
        name = rng.choice(NAMES)
        definition = DICTIONARY.packet(name)
        iteration = {"cycle_running": not 20 < k % 50 < 30, "iteration": 100 + k // 50}
        values = {f.name: iteration.get(f.name, a_value(f, rng, k)) for f in definition.values}
        lists = {
            group.name: tuple({i.name: a_value(i, rng, k) for i in group.items} for _ in range(k % 3))
            for group in definition.fields
            if isinstance(group, Group)
        }
        message = decode(definition.fields, encode(definition.fields, values, lists))
        found.append(Telemetry(name, float(k), k % 2, message.raw, message.values, message.lists))
    return found


def a_value(item: Any, rng: random.Random, k: int) -> Any:
    """In limits, in runs of some packets out of them, now and then unknown."""
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
    """The same in every process."""
    return sum(map(ord, name))


def test_packets_stored_together_are_those_stored_one_by_one(tmp_path: Path, clock: Any) -> None:
    """Every byte of the rows of telemetry, alarms and events, the latest values, and the last judgement of each field."""
    heard = packets(144, seed=3)
    one, many = Room(tmp_path / "one", clock), Room(tmp_path / "many", clock)
    for packet in heard:
        one.hear(packet)
    for k in range(0, len(heard), 48):
        many.hear(*heard[k : k + 48])
    assert len(one.rows("telemetry_packets")) == len(heard)
    assert len(one.rows("alarms")) > 5
    for table in ("telemetry_packets", "alarms", "events"):
        assert one.rows(table) == many.rows(table), table
    assert repr(one.telemetry.values()) == repr(many.telemetry.values())
    for room in (one, many):
        room.database.close()


def test_what_is_calm_is_judged_as_if_it_were_looked_at(database: Database, bus: EventBus, clock: Any) -> None:
    """A board that passes over what is calm says of every value what one says that judges each sample; changes of the limits and
    restarts in between included. Of the judgements it leaves out none but calm ones."""
    book = LimitBook(DICTIONARY, database, bus, clock)
    quick, thorough = TelemetryBoard(DICTIONARY, book.rule), TelemetryBoard(DICTIONARY, book.rule)
    book.subscribe(quick.limits_changed)
    book.subscribe(thorough.limits_changed)
    left_out = told = 0
    for k, packet in enumerate(packets(220, seed=8)):
        if k == 80:
            book.override("housekeeping.sensor_temperature_c", Limits(watch=(-1.0, 1.0)), 2, user="ann")
        if k == 140:
            book.choose("commissioning", user="ann")
        thorough.followed = lambda: Everything()
        thorough._look_again()
        expected, found = thorough.take(packet, clock()), quick.take(packet, clock())
        assert repr(quick.values(clock())) == repr(thorough.values(clock())), k
        rest = [j for j in expected if j not in found]
        assert [j for j in expected if j in found] == found
        assert all(j.state == "ok" for j in rest)
        left_out, told = left_out + len(rest), told + len(found)
    assert left_out > told > 100, (left_out, told)


def test_a_field_that_is_followed_is_told_while_it_is_calm(database: Database, bus: EventBus, clock: Any) -> None:
    """An open alarm hears of every sample of its field."""
    book = LimitBook(DICTIONARY, database, bus, clock)
    board = TelemetryBoard(DICTIONARY, book.rule)
    fields = {"sensor_temperature_c": 20.0, "cycle_running": True}
    packet = Telemetry("housekeeping", 1.0, 0, fields, fields)
    for _ in range(5):
        board.take(packet, clock())
    assert board.take(packet, clock()) == []
    board.followed = lambda: {("housekeeping", "sensor_temperature_c")}
    (judgement,) = board.take(packet, clock())
    assert (judgement.field.name, judgement.value, judgement.state) == ("sensor_temperature_c", 20.0, "ok")


class Everything(Sequence[Any]):
    """Holds whatever it is asked for."""

    def __contains__(self, _: object) -> bool:
        return True

    def __len__(self) -> int:
        return 0

    def __getitem__(self, _: Any) -> Any:
        raise IndexError
