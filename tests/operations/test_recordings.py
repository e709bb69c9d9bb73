"""Rerun recordings out of the store and live, read again by rerun's own reader."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from gss.domain.errors import BadInput, Conflict, NotFound
from gss.operations.recordings.live import AT_ONCE
from gss.operations.recordings.ranges import ids_of
from gss.settings import Settings
from gss.store.models import TelemetryPacket
from gss.wiring import Services, build

START = datetime(2026, 11, 21, 18, 0, tzinfo=UTC)


@pytest.fixture(scope="module")
def services(tmp_path_factory: pytest.TempPathFactory):
    """Connected services that never start, with four dark frames a second apart, telemetry and a word in the record."""
    made = build(Settings(data=tmp_path_factory.mktemp("data")))
    pixels = np.random.default_rng(1).integers(8, 14, (64, 128)).astype(np.uint8)
    for k in range(4):
        values = {"taken": START + timedelta(seconds=k), "bits": 8, "profile": None, "mode": "tracking"}
        made.frames.add_from_device(pixels, values)
    with made.database.unit_of_work() as session:
        session.add_all(packet(k) for k in range(4))
    yield made
    made.stop()


def packet(k: int) -> TelemetryPacket:
    """One of housekeeping."""
    values = {"sensor_temperature_c": 20.0 + k, "stars_matched": 9}
    moment = START + timedelta(seconds=k)
    return TelemetryPacket(packet="housekeeping", received=moment, device_time_s=float(k), request_id=0, values=values)


def entities(data: bytes, tmp_path: Path) -> dict[str, set[str]]:
    """Entity paths of a recording with the timelines they are on, as the reference reader finds them."""
    from rerun.chunk import RrdReader

    file = tmp_path / "one.rrd"
    file.write_bytes(data)
    schema = RrdReader(str(file)).store().schema()
    found: dict[str, set[str]] = {str(c.entity_path).lstrip("/"): set() for c in schema.component_columns()}
    found[""] = {str(c.name) for c in schema.index_columns()}
    return found


def test_a_sequence_holds_pictures_telemetry_and_sky_on_both_timelines(services, tmp_path):
    """Frames by number and by UTC; the catalogue's stars are static."""
    scope = services.scopes.of_frames([1, 2, 3])
    found = entities(services.recordings.write(scope), tmp_path)
    assert {"camera/image", "sky/stars", "telemetry/sensor_temperature_c", "telemetry/stars_matched"} <= set(found)
    assert found[""] == {"frame", "utc"}
    assert scope.start < START < scope.end


def test_neighbours_come_with_a_frame(services):
    """A page's frame with those before and after it, as far as there are any."""
    assert services.scopes.around(2, 1).frame_ids == (1, 2, 3)
    assert services.scopes.around(4, 12).frame_ids == (1, 2, 3, 4)


@pytest.mark.parametrize("what", ["of_contact", "of_calibration", "of_analysis", "of_campaign"])
def test_what_is_not_there_is_said(services, what):
    """No recording of nothing."""
    with pytest.raises(NotFound):
        getattr(services.scopes, what)(77)
    with pytest.raises(BadInput):
        services.scopes.of_frames([])


def test_a_live_recording_grows_with_what_happens(services: Services, tmp_path, request):
    """The first piece has layout, sky and the frames before; each event and frame makes a piece; silence makes none."""
    woken: list[int] = []
    first, live = services.live_recordings.open(lambda: woken.append(1))
    request.addfinalizer(lambda: services.live_recordings.close(live))
    assert {"sky/stars", "camera/image"} <= set(entities(first, tmp_path))
    assert live.piece() == b""
    services.bus.record("link", "warning", "the line went silent")
    assert woken
    assert set(entities(live.piece(), tmp_path)) >= {"log/events"}
    services.bus.publish("frame", services.frames.get(2))
    piece = live.piece()
    assert "camera/image" in entities(piece, tmp_path)
    assert piece[:4] == b"RRF2"


def test_only_a_few_live_recordings_are_open_at_once(services):
    """One more is refused in words, and a closed one makes room."""
    opened = [services.live_recordings.open(lambda: None)[1] for _ in range(AT_ONCE)]
    try:
        with pytest.raises(Conflict, match="too many"):
            services.live_recordings.open(lambda: None)
        services.live_recordings.close(opened.pop())
        opened.append(services.live_recordings.open(lambda: None)[1])
    finally:
        for live in opened:
            services.live_recordings.close(live)


def test_an_opening_that_fails_keeps_nothing(services, monkeypatch):
    """The place is free again, and nobody listens."""

    def broken(*_arguments, **_named):
        raise OSError("the disk is gone")

    listening = len(services.bus._subscriptions)
    with monkeypatch.context() as patch:
        patch.setattr(services.recordings, "frame", broken)
        for _ in range(AT_ONCE + 1):
            with pytest.raises(OSError, match="disk"):
                services.live_recordings.open(lambda: None)
    assert len(services.bus._subscriptions) == listening
    services.live_recordings.close(services.live_recordings.open(lambda: None)[1])


def test_a_frame_that_was_removed_meanwhile_is_left_out(services, monkeypatch):
    """Of those from before, as of those that come."""
    real = services.recordings.frame

    def without_the_last(recorder, frame_id, picture):
        if frame_id == 4:
            raise NotFound("no such frame")
        real(recorder, frame_id, picture)

    monkeypatch.setattr(services.recordings, "frame", without_the_last)
    first, live = services.live_recordings.open(lambda: None)
    services.live_recordings.close(live)
    assert first[:4] == b"RRF2"


def test_ranges_are_read_as_people_write_them():
    """Numbers and ranges, in order; anything else is refused with what was expected."""
    assert ids_of("3,5-7") == [3, 5, 6, 7]
    for bad in ("", "3-1", "a", "1-999999", "²"):
        with pytest.raises(BadInput):
            ids_of(bad)
