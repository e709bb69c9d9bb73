"""Data about the device's latest frames, and the results that the device reported for them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from gss.domain.json_object import JsonObject
from gss.operations.frames.frames import FrameService
from gss.operations.frames.onboard_results import OnboardRecord
from gss.operations.frames.replay import ReplayService
from gss.operations.line.link import LinkService
from gss.operations.transfers.device_tables import DeviceTableService
from gss.store.models import Frame, Transfer

REMEMBERED_FRAMES = 64
SETTINGS = ("threshold_dn", "min_pixels", "max_pixels")


@dataclass(frozen=True)
class FrameFacts:
    """Data about a frame. ``info``: the device's frame_info. ``settings``: detection settings and ``bank_sha256``. ``truth``:
    true attitude quaternion from a simulator."""

    info: Mapping[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    truth: list[float] | None = None

    def plain(self) -> dict[str, object]:
        """Return the data as JSON values for the row of a transfer."""
        info = {k: v.hex() if isinstance(v, bytes) else v for k, v in self.info.items()}
        return {"info": info, "settings": dict(self.settings), "truth": self.truth}


class FrameRecords:
    """Joins stored frames with the results that the device reported for them. The frame or its results can arrive
    first.

    Frames are identified by the device's frame numbers. All data are discarded when the device restarts, because the
    device can then reuse numbers.
    """

    def __init__(
        self, link: LinkService, tables: DeviceTableService, frames: FrameService, replay: ReplayService
    ) -> None:
        self._link, self._tables, self._frames, self._replay = link, tables, frames, replay
        self._infos: OrderedDict[int, Mapping[str, Any]] = OrderedDict()
        self._settings: OrderedDict[int, Mapping[str, Any]] = OrderedDict()
        self._truths: OrderedDict[int, list[float]] = OrderedDict()
        self.device_starts = 0
        """Number of HELLO reports received since the server started."""
        self._records: OrderedDict[int, OnboardRecord] = OrderedDict()
        self._stored: OrderedDict[int, Frame] = OrderedDict()

    def forget(self) -> None:
        """Discard all data, because the device restarted."""
        self.device_starts += 1
        for memory in (self._infos, self._settings, self._truths, self._records, self._stored):
            memory.clear()

    def described(self, number: int, info: Mapping[str, Any]) -> bool:
        """Store the device's description of a frame with the active settings. Return False if the frame was already described or
        has no number."""
        if number in self._infos or number == 0:
            return False
        remember(self._infos, number, info)
        remember(self._settings, number, self.settings())
        return True

    def true_attitude(self, number: int, quaternion: list[float]) -> None:
        """Store the true attitude of a frame, as reported by a simulator."""
        remember(self._truths, number, quaternion)

    def facts(self, number: int) -> FrameFacts:
        """Return the stored data about a frame; empty if there are none."""
        return FrameFacts(self._infos.get(number, {}), self._settings.get(number, {}), self._truths.get(number))

    def facts_for(self, transfer: Transfer, number: int) -> FrameFacts:
        """Return the data about a frame. Missing data are taken from the data stored at the start of the transfer, unless those
        are about another frame."""
        stored_facts = transfer.options.get("facts") or {}
        if int(stored_facts.get("info", {}).get("frame_number", number)) != number:
            stored_facts = {}
        now = self.facts(number)
        return FrameFacts(
            now.info or stored_facts.get("info", {}),
            now.settings or stored_facts.get("settings", {}),
            now.truth or stored_facts.get("truth"),
        )

    def settings(self) -> JsonObject:
        """Return the active detection settings, bank and tables of the device in the form in which they are stored with a
        frame."""
        status = self._link.status()
        settings: JsonObject = {name: status[name] for name in SETTINGS if name in status}
        sha256 = status.get("catalogue_sha256")
        if sha256 is not None:
            settings["bank_sha256"] = sha256.hex() if isinstance(sha256, bytes) else str(sha256)
        tables = self._tables.at_work()
        return settings | ({"tables": tables} if tables else {})

    def of(self, number: int) -> OnboardRecord:
        """Return the results that the device has reported for a frame up to now."""
        return self._records.get(number) or OnboardRecord(number)

    def reported(self, number: int, record: OnboardRecord) -> None:
        """Store an updated record of the device's results for a frame, and join it with the frame if the frame is stored."""
        remember(self._records, number, record)
        if number in self._stored:
            self._join(self._stored[number], record)

    def stored(self, number: int, frame: Frame) -> None:
        """Register a stored frame, and join it with the device's results if there are any."""
        remember(self._stored, number, frame)
        if number in self._records:
            self._join(frame, self._records[number])

    def _join(self, frame: Frame, record: OnboardRecord) -> None:
        if not record.centroids:
            return
        solution = self._frames.add_on_board(frame, record)
        if record.attitude is not None:
            self._replay.queue(frame, record, solution)


def remember(memory: OrderedDict[int, Any], number: int, value: Any) -> None:
    """Store a value by frame number. Drop the oldest values if there are more than ``REMEMBERED_FRAMES``."""
    memory[number] = value
    memory.move_to_end(number)
    while len(memory) > REMEMBERED_FRAMES:
        memory.popitem(last=False)
