"""Data about the device's newest frames, and the results that the device reported for them."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

from gss.operations.frames.frame_memory import FrameMemory, remember
from gss.operations.frames.frames import FrameService
from gss.operations.frames.onboard_results import OnboardRecord
from gss.operations.frames.replay import ReplayService
from gss.operations.line.link import LinkService
from gss.operations.transfers.device_tables import DeviceTableService
from gss.store.models import Frame

SETTINGS = ("threshold_dn", "min_pixels", "max_pixels")


class FrameRecords:
    """Joins a stored frame with the device's own result, whichever is available first.

    Frame numbers are the device's; everything is discarded when it restarts, because numbers may start again.
    """

    def __init__(
        self, link: LinkService, tables: DeviceTableService, frames: FrameService, replay: ReplayService
    ) -> None:
        self._link, self._tables, self._frames, self._replay = link, tables, frames, replay
        self.memory = FrameMemory()
        self.device_starts = 0
        """Number of times that a device sent HELLO since the server started."""
        self._records: OrderedDict[int, OnboardRecord] = OrderedDict()
        self._stored: OrderedDict[int, Frame] = OrderedDict()

    def forget(self) -> None:
        """Discard everything, because the device restarted."""
        self.device_starts += 1
        self._records.clear()
        self._stored.clear()
        self.memory.forget()

    def settings(self) -> dict[str, Any]:
        """Return the detection settings, bank and tables that the device currently uses."""
        housekeeping = self._link.session.housekeeping or {}
        settings: dict[str, Any] = {name: housekeeping[name] for name in SETTINGS if name in housekeeping}
        sha256 = housekeeping.get("catalogue_sha256")
        if sha256 is not None:
            settings["bank_sha256"] = sha256.hex() if isinstance(sha256, bytes) else str(sha256)
        tables = self._tables.at_work()
        return settings | ({"tables": tables} if tables else {})

    def of(self, number: int) -> OnboardRecord:
        """Return what the device has reported for its frame so far."""
        return self._records.get(number) or OnboardRecord(number)

    def reported(self, number: int, record: OnboardRecord) -> None:
        """Store a further report of the device about a frame."""
        remember(self._records, number, record)
        if number in self._stored:
            self._join(self._stored[number], record)

    def stored(self, number: int, frame: Frame) -> None:
        """Remember a stored frame, and join it with the device's report if there is one."""
        remember(self._stored, number, frame)
        if number in self._records:
            self._join(frame, self._records[number])

    def _join(self, frame: Frame, record: OnboardRecord) -> None:
        if not record.centroids:
            return
        solution = self._frames.add_on_board(frame, record)
        if record.attitude is not None:
            self._replay.queue(frame, record, solution)
