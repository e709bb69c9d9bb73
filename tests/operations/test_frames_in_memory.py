"""A frame is solved from the received pixels, not from the stored ones."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sqlalchemy.exc import IntegrityError

from gss.device.session_events import Direction, TransferDone
from gss.instruments.registry import shipped_camera
from gss.operations.frames import solve_queue
from gss.operations.frames.onboard_results import OnboardRecord
from gss.operations.line.line_events import LineBatch
from gss.operations.transfers.arrivals import ContentArrived
from gss.settings import Settings
from gss.store.blobs import BlobStore
from gss.store.models import Transfer
from gss.wiring.build import build
from gss.wiring.services import Services

CAMERA = shipped_camera("cubestar").camera


@pytest.fixture
def services(tmp_path: Path) -> Iterator[Services]:
    services = build(Settings(data=tmp_path))
    yield services
    services.frames.frames.stop()
    services.base.database.close()


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Keys of the blobs that were read."""
    keys: list[str] = []
    real = BlobStore.get

    def get(self: BlobStore, key: str) -> bytes:
        keys.append(key)
        return real(self, key)

    monkeypatch.setattr(BlobStore, "get", get)
    return keys


def receive_frame(services: Services) -> Any:
    """Store a dark frame from the device and wait until the solver thread has processed it."""
    facts = {"taken": datetime.now(UTC), "bits": 8, "profile": "cubestar", "number": 1}
    frame = services.frames.frames.add_from_device(np.zeros((CAMERA.rows, CAMERA.columns), np.uint8), facts)
    services.frames.frames.queue._pool.submit(int).result()
    return frame


def test_a_frame_is_solved_from_memory(services: Services, reads: list[str]) -> None:
    """A frame is stored and solved without reading its stored pixels."""
    frame = receive_frame(services)
    ground = services.frames.frames.detail(frame.id).ground
    assert ground is not None
    assert ground.outcome == "none"
    assert reads == []
    assert services.frames.frames.pixels(frame).shape == (CAMERA.rows, CAMERA.columns)


def test_pixels_beyond_the_memory_limit_are_read_back(
    services: Services, reads: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A frame received while the queue is full is solved with the pixels from the store."""
    monkeypatch.setattr(solve_queue, "MAX_PIXEL_BYTES", 0)
    frame = receive_frame(services)
    assert services.frames.frames.detail(frame.id).ground is not None
    assert reads == [frame.sha256]


def test_a_repeated_number_after_a_clock_reset_is_another_frame(services: Services) -> None:
    """Sensors that number images by time repeat numbers after each power-up. A frame with the same number is known only if
    its time is similar, so that a new image is downloaded."""
    frame = receive_frame(services)
    frames = services.frames.frames
    assert frames.has_number(1, frame.taken + timedelta(seconds=5))
    assert not frames.has_number(1, frame.taken + timedelta(minutes=10))
    assert not frames.has_number(2, frame.taken)


def test_an_on_board_result_stays_if_its_replacement_cannot_be_stored(services: Services) -> None:
    """A more complete result of the sensor replaces the earlier one in one transaction."""
    frames, frame = services.frames.frames, receive_frame(services)
    first = frames.add_on_board(frame, OnboardRecord(1))
    with services.base.database.engine.begin() as connection:
        connection.exec_driver_sql("CREATE TRIGGER f BEFORE INSERT ON solutions BEGIN SELECT RAISE(ABORT, 'full'); END")
    with pytest.raises(IntegrityError, match="full"):
        frames.add_on_board(frame, OnboardRecord(1, attitude={"outcome": "none"}))
    assert frames.detail(frame.id).on_board.id == first.id
    with services.base.database.engine.begin() as connection:
        connection.exec_driver_sql("DROP TRIGGER f")
    second = frames.add_on_board(frame, OnboardRecord(1, attitude={"outcome": "none"}))
    on_board = [row.id for row in frames.detail(frame.id).solutions if row.origin == "on board"]
    assert on_board == [second.id]


def test_a_downloaded_frame_without_a_time_has_an_unknown_time(services: Services) -> None:
    """The time of its download is not the time of its exposure."""
    info = {"frame_number": 7, "columns": 4, "rows": 3, "bits": 8}
    transfer = Transfer(id=1, kind="frame", target="2", options={"facts": {"info": info}})
    done = TransferDone(1, Direction.DOWN, "frame", 2, 7, bytes(12), "")
    arrived = ContentArrived(transfer, done)
    services.intake.frames.handle(LineBatch((arrived,), datetime.now(UTC), 0.0))
    services.transfers.writer.finish(20)
    assert not services.frames.frames.get(arrived.answers.links()["frame_id"]).time_known
