"""Rerun recordings from the store and live, read with the reader of rerun."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from gss.domain.camera_record import record_of
from gss.domain.errors import BadInput, Conflict, NotFound
from gss.instruments.registry import shipped_camera
from gss.operations.frames.frame_detail import FrameDetail
from gss.operations.frames.place import Place
from gss.operations.recordings import scope, stored
from gss.operations.recordings.blueprints import Use
from gss.operations.recordings.lanes import Lanes
from gss.operations.recordings.live import MAX_OPEN, MAX_PER_USER
from gss.operations.recordings.ranges import ids_of
from gss.operations.recordings.recorder import Recorder
from gss.settings import Settings
from gss.store.models import Command, CommandStage, Contact, Frame, Solution, TelemetryPacket
from gss.wiring.build import build
from gss.wiring.services import Services

START = datetime(2026, 11, 21, 18, 0, tzinfo=UTC)


@pytest.fixture(scope="module")
def services(tmp_path_factory: pytest.TempPathFactory):
    """Connected services that are never started, with four dark frames a second apart, telemetry and one recorded
    event.
    """
    built = build(Settings(data=tmp_path_factory.mktemp("data")))
    pixels = np.random.default_rng(1).integers(8, 14, (64, 128)).astype(np.uint8)
    for k in range(4):
        values = {"taken": START + timedelta(seconds=k), "bits": 8, "profile": None, "mode": "tracking"}
        built.frames.frames.add_from_device(pixels, values)
    with built.base.database.unit_of_work() as session:
        session.add_all(packet(k) for k in range(4))
    yield built
    built.stop()


def packet(k: int) -> TelemetryPacket:
    """Return one housekeeping packet."""
    values = {"sensor_temperature_c": 20.0 + k, "stars_matched": 9, "mode": "tracking"}
    moment = START + timedelta(seconds=k)
    return TelemetryPacket(packet="housekeeping", received=moment, device_time_s=float(k), request_id=0, values=values)


def entities(data: bytes, tmp_path: Path) -> dict[str, set[str]]:
    """Return entity paths of a recording with their timelines, as the reference reader finds them."""
    from rerun.chunk import RrdReader

    file = tmp_path / "one.rrd"
    file.write_bytes(data)
    schema = RrdReader(str(file)).store().schema()
    found: dict[str, set[str]] = {str(c.entity_path).lstrip("/"): set() for c in schema.component_columns()}
    found[""] = {str(c.name) for c in schema.index_columns()}
    return found


def test_a_sequence_contains_pictures_telemetry_and_sky_on_both_timelines(services, tmp_path):
    """A recording has frames, telemetry and sky, with timelines by frame number and by UTC."""
    scope = services.recordings.scopes.of_frames([1, 2, 3])
    found = entities(services.recordings.stored.write(scope), tmp_path)
    assert {"camera/image", "sky/stars", "telemetry/sensor_temperature", "states/mode", "states/link"} <= set(found)
    assert found[""] == {"frame", "utc"}
    assert scope.start < START < scope.end


def frames_of(data: bytes, tmp_path: Path) -> dict[str, list[int]]:
    """Return the numbers of the frames with a row in a recording, by entity path."""
    from rerun.chunk import RrdReader

    file = tmp_path / "rows.rrd"
    file.write_bytes(data)
    found: dict[str, list[int]] = {}
    for chunk in RrdReader(str(file)).stream().to_chunks():
        if "frame" in chunk.timeline_names:
            numbers = chunk.to_record_batch().column("frame").to_pylist()
            found.setdefault(str(chunk.entity_path).lstrip("/"), []).extend(numbers)
    return {path: sorted(set(numbers)) for path, numbers in found.items()}


def solution(frame_id: int) -> Solution:
    """Return a solved ground result without stars."""
    camera = shipped_camera("cubestar").camera
    detail = {"regions": [], "stars": [], "predicted": []}
    values = {"frame_id": frame_id, "origin": "ground", "chain": "reference", "version": "1", "created": START}
    return Solution(
        **values, outcome="solved", quaternion=[0.0, 0.0, 0.0, 1.0], camera=record_of(camera), matched=9, detail=detail
    )


def test_frames_without_picture_have_no_marks(services, tmp_path, monkeypatch):
    """With more frames than pictures, marks of stars are recorded with their picture only. Every frame has its figures
    and its field of view.
    """
    monkeypatch.setattr(stored, "MAX_PICTURES", 2)
    monkeypatch.setattr(
        services.frames.frames,
        "detail",
        lambda i, overlays: FrameDetail(services.frames.frames.get(i), [solution(i)], None, solution(i)),
    )
    frames_1_to_3 = services.recordings.scopes.of_frames([1, 2, 3])
    found = frames_of(services.recordings.stored.write(frames_1_to_3), tmp_path)
    assert found["camera/image"] == found["camera/image/centroids"] == [1, 3]
    assert found["sky/field"] == found["stars/reference/matched"] == [1, 2, 3]


def test_the_path_is_written_again_only_after_a_movement(services, tmp_path):
    """Every frame writes the position. The path, with all its points, is written once per degree of movement."""

    def place(moment: datetime) -> Place:
        angle = np.radians((moment - START).total_seconds() * 0.6)
        return Place(7000.0 * np.array([np.cos(angle), np.sin(angle), 0.0]), "TLE")

    recorder = Recorder("path", Use.CONTACT, services.recordings.stored._stars, place)
    for frame_id in range(1, 5):
        frame = services.frames.frames.get(frame_id)
        recorder.frame(FrameDetail(frame, [], None, solution(frame_id)), None)
    found = frames_of(recorder.take(), tmp_path)
    assert found["sky/orbit/position"] == [1, 2, 3, 4]
    assert found["sky/orbit/path"] == [1, 3]


def test_lanes_show_states_where_they_change():
    """A lane gets one entry per change, "no packets" where packets are missing, and is empty after a command has ended."""
    written: list[tuple[float, str, str | None]] = []
    lanes = Lanes(lambda at, path, state: written.append(((at - START).total_seconds(), path, state)))
    for second, mode in ((0, "tracking"), (1, "tracking"), (2, "assisted"), (12, "assisted")):
        lanes.telemetry(START + timedelta(seconds=second), {"mode": mode, "active_bank": "a"})
    stages = [CommandStage(stage=name, at=START + timedelta(seconds=k)) for k, name in enumerate(("sent", "accepted"))]
    lanes.command(Command(name="TAKE_IMAGE", stages=stages, finished=START + timedelta(seconds=2)))
    assert written == [
        (0, "states/link", "up"),
        (0, "states/mode", "tracking"),
        (0, "states/bank", "a"),
        (2, "states/mode", "assisted"),
        (7, "states/link", "no packets"),
        (12, "states/link", "up"),
        (0, "states/command", "TAKE_IMAGE sent"),
        (1, "states/command", "TAKE_IMAGE accepted"),
        (2, "states/command", None),
    ]


def test_a_frame_is_recorded_with_its_neighbours(services):
    """A frame is recorded with the frames before and after it, if they exist."""
    assert services.recordings.scopes.around(2, 1).frame_ids == (1, 2, 3)
    assert services.recordings.scopes.around(4, 12).frame_ids == (1, 2, 3, 4)


def test_a_long_contact_is_thinned_evenly(services, monkeypatch):
    """With more frames than allowed, every n-th frame of the whole contact is kept, and the latest one."""
    with services.base.database.unit_of_work() as session:
        contact = Contact(url="test", started=START, ended=START + timedelta(seconds=9))
        session.add(contact)
        session.flush()
        for frame_id in (1, 2, 3, 4):
            session.get_one(Frame, frame_id).contact_id = contact.id
        contact_id = contact.id
    whole = services.recordings.scopes.of_contact(contact_id)
    assert (whole.frame_ids, whole.every) == ((1, 2, 3, 4), 1)
    monkeypatch.setattr(scope, "MAX_FRAMES", 3)
    thinned = services.recordings.scopes.of_contact(contact_id)
    assert (thinned.frame_ids, thinned.every) == ((2, 4), 2)


@pytest.mark.parametrize("what", ["of_contact", "of_calibration", "of_analysis", "of_campaign"])
def test_an_empty_recording_is_rejected(services, what):
    """A selection without frames is rejected."""
    with pytest.raises(NotFound):
        getattr(services.recordings.scopes, what)(77)
    with pytest.raises(BadInput):
        services.recordings.scopes.of_frames([])


def test_a_live_recording_grows_with_events_and_frames(services: Services, tmp_path, request):
    """The first block has sky and earlier frames. Each event and frame adds a block, and idle time none."""
    woken: list[int] = []
    first, live = services.recordings.live.open(lambda: woken.append(1), "ann")
    request.addfinalizer(lambda: services.recordings.live.close(live))
    assert {"sky/stars", "camera/image"} <= set(entities(first, tmp_path))
    assert live.piece() == b""
    services.base.bus.record("link", "warning", "the line went silent")
    assert woken
    assert set(entities(live.piece(), tmp_path)) >= {"log/events"}
    services.base.bus.publish("frame", services.frames.frames.get(2))
    piece = live.piece()
    assert "camera/image" in entities(piece, tmp_path)
    assert piece[:4] == b"RRF2"


def test_the_number_of_live_recordings_is_limited(services):
    """A recording above the limit is rejected. After another one is closed, it can be opened."""
    opened = [services.recordings.live.open(lambda: None, f"user {k // MAX_PER_USER}")[1] for k in range(MAX_OPEN)]
    try:
        with pytest.raises(Conflict, match="too many"):
            services.recordings.live.open(lambda: None, "another user")
        services.recordings.live.close(opened.pop())
        opened.append(services.recordings.live.open(lambda: None, "another user")[1])
    finally:
        for live in opened:
            services.recordings.live.close(live)


def test_the_number_of_live_recordings_per_user_is_limited(services):
    """A user with the maximum number of recordings cannot open another one, but other users can."""
    opened = [services.recordings.live.open(lambda: None, "ann")[1] for _ in range(MAX_PER_USER)]
    try:
        with pytest.raises(Conflict, match="per user"):
            services.recordings.live.open(lambda: None, "ann")
        opened.append(services.recordings.live.open(lambda: None, "ben")[1])
    finally:
        for live in opened:
            services.recordings.live.close(live)


@pytest.mark.parametrize("text", ["9" * 400, "3-" + "9" * 5000, str(2**31), "1,99999999999999999999"])
def test_numbers_beyond_every_frame_are_bad_input(text):
    """Numbers too large for a frame are rejected before they are passed to the database."""
    with pytest.raises(BadInput, match="no frame has this number"):
        ids_of(text)


def test_a_failed_opening_leaves_no_subscriber(services, monkeypatch):
    """A failed opening leaves no subscriber and does not count against the limit."""

    def broken(*_arguments, **_named):
        raise OSError("the disk is gone")

    subscribers_before = len(services.base.bus._subscriptions)
    with monkeypatch.context() as patch:
        patch.setattr(services.recordings.stored, "frame", broken)
        for _ in range(MAX_OPEN + 1):
            with pytest.raises(OSError, match="disk"):
                services.recordings.live.open(lambda: None, "ann")
    assert len(services.base.bus._subscriptions) == subscribers_before
    services.recordings.live.close(services.recordings.live.open(lambda: None, "ann")[1])


def test_a_frame_that_was_deleted_meanwhile_is_left_out(services, monkeypatch):
    """A live recording is opened without an earlier frame that was deleted meanwhile."""
    real = services.recordings.stored.frame

    def without_the_last(recorder, frame_id, picture):
        if frame_id == 4:
            raise NotFound("no such frame")
        real(recorder, frame_id, picture)

    monkeypatch.setattr(services.recordings.stored, "frame", without_the_last)
    first, live = services.recordings.live.open(lambda: None, "ann")
    services.recordings.live.close(live)
    assert first[:4] == b"RRF2"


def test_frame_ranges_are_parsed():
    """Numbers and ranges are parsed in order. Other text is rejected."""
    assert ids_of("3,5-7") == [3, 5, 6, 7]
    for bad in ("", "3-1", "a", "1-999999", "²"):
        with pytest.raises(BadInput):
            ids_of(bad)
