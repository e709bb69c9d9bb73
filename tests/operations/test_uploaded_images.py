"""Solution of an uploaded frame on board: the server sends each command after the previous one of the same solution."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from gss.domain.errors import Conflict
from gss.settings import Settings
from gss.store.commands import Filter
from gss.wiring.build import build
from gss.wiring.services import Services

CHAIN = ["FIND_CENTROIDS", "MATCH_STARS", "CALCULATE_ATTITUDE"]


class Ground:
    """All ground services with a sensor in memory and one frame of it."""

    def __init__(self, folder: Path, sensor: Any) -> None:
        self.services: Services = build(Settings(data=folder))
        self.commands, self.uploads = self.services.commanding.commands, self.services.intake.images
        self.services.transfers.transfers.start()
        self.commands.start()
        self.services.dispatcher.start()
        self.services.line.link.start()
        sensor.keep_pace_with(self.services.line.link.events)
        self.services.line.link.open_later(sensor.url)
        self.wait(lambda: self.services.line.link.hello is not None)
        self.run("TAKE_IMAGE")
        self.wait(lambda: [frame for frame, _ in self.services.frames.frames.page(5, 0)[1] if frame.complete])
        self.frame_id = self.services.frames.frames.page(5, 0)[1][0][0].id

    def wait(self, done: Callable[[], Any]) -> None:
        """Wait until ``done()`` is true. The timeout in real time only limits how long a failing test runs."""
        limit_s = time.monotonic() + 60
        while not done():
            assert time.monotonic() < limit_s, [event.text for event in self.services.base.bus.after(0, 1000)][-8:]
            time.sleep(0.005)

    def run(self, name: str, **arguments: Any) -> None:
        """Send a command that does not belong to a solution, and wait for its end."""
        row = self.commands.send(name, arguments, confirm="", user="ann", source="server")
        self.wait(lambda: self.commands.get(row.id).finished)

    def solve(self, slot: int) -> None:
        """Upload the frame to a slot and request its solution."""
        self.uploads.upload(self.frame_id, slot, solve=True)

    def sent(self) -> list[tuple[str, Any]]:
        """Return (name, slot) of the commands of the chain that the server has sent, oldest first."""
        rows = self.services.commanding.history.page(Filter(user="gss", names=tuple(CHAIN)), 50)
        return [(row.name, row.arguments.get("slot")) for row in reversed(rows)]


@pytest.fixture
def ground(tmp_path: Path, sensor_in_memory: Callable[..., Any]) -> Iterator[Ground]:
    new_ground = Ground(tmp_path, sensor_in_memory())
    yield new_ground
    new_ground.services.stop()


def test_a_solution_that_could_not_begin_is_not_begun_by_a_later_list(
    ground: Ground, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The request for the list was rejected. Neither the list of a user nor that of another upload begins the solution, and the
    other upload is solved in its own slot."""
    send, rejected = ground.commands.send, []

    def rejects_once(name: str, *given: Any, **how: Any) -> Any:
        if name == "LIST_FRAMES" and how["user"] == "gss" and not rejected:
            rejected.append(name)
            raise Conflict("the line is down")
        return send(name, *given, **how)

    monkeypatch.setattr(ground.commands, "send", rejects_once)
    ground.solve(0)
    ground.wait(lambda: rejected)
    ground.run("LIST_FRAMES")
    ground.solve(1)
    ground.wait(lambda: len(ground.sent()) == len(CHAIN))
    assert ground.sent() == [(CHAIN[0], 1), (CHAIN[1], None), (CHAIN[2], None)]


def test_a_new_contact_ends_a_solution(ground: Ground, monkeypatch: pytest.MonkeyPatch) -> None:
    """The report on the list arrives after the link was opened again. The server does not continue."""
    held: list[Any] = []
    with monkeypatch.context() as patch:
        patch.setattr(ground.uploads, "_completed", held.append)
        ground.solve(0)
        ground.wait(lambda: any(event.name == "LIST_FRAMES" for event in held))
    link = ground.services.line.link
    url = link.url
    link.close()
    link.open_later(url)
    ground.wait(lambda: link.connected and link.hello is not None and not ground.uploads._solving)
    for event in held:
        ground.uploads._completed(event)
    assert ground.sent() == []
