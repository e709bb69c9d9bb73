"""Data about the newest frames that arrived before their pixels: description, settings at that time, true attitude of a
simulation."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from gss.store.models import Transfer

REMEMBERED_FRAMES = 64


@dataclass(frozen=True)
class FrameFacts:
    """``info``: the device's frame_info; ``settings``: detection settings and ``bank_sha256``; ``truth``: quaternion."""

    info: Mapping[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    truth: list[float] | None = None

    def plain(self) -> dict[str, Any]:
        """Return JSON values for the row of a transfer."""
        info = {k: v.hex() if isinstance(v, bytes) else v for k, v in self.info.items()}
        return {"info": info, "settings": dict(self.settings), "truth": self.truth}


def remember(memory: OrderedDict[int, Any], number: int, value: Any) -> None:
    """Store a value and drop the oldest beyond ``REMEMBERED_FRAMES``."""
    memory[number] = value
    memory.move_to_end(number)
    while len(memory) > REMEMBERED_FRAMES:
        memory.popitem(last=False)


class FrameMemory:
    """Facts by the device's frame number. They are discarded when the device restarts, because frame numbers may start
    again."""

    def __init__(self) -> None:
        self._infos: OrderedDict[int, Mapping[str, Any]] = OrderedDict()
        self._settings: OrderedDict[int, Mapping[str, Any]] = OrderedDict()
        self._truths: OrderedDict[int, list[float]] = OrderedDict()

    def forget(self) -> None:
        """Discard everything, because the device restarted."""
        for memory in (self._infos, self._settings, self._truths):
            memory.clear()

    def told(self, number: int, info: Mapping[str, Any], settings: Mapping[str, Any]) -> bool:
        """Store the description of a frame. Return False if it was already known."""
        if number in self._infos or number == 0:
            return False
        remember(self._infos, number, info)
        remember(self._settings, number, settings)
        return True

    def true_attitude(self, number: int, quaternion: list[float]) -> None:
        """Store the true attitude of a frame, as reported by a simulator."""
        remember(self._truths, number, quaternion)

    def facts(self, number: int) -> FrameFacts:
        """Return the known facts of a frame; empty if there are none."""
        return FrameFacts(self._infos.get(number, {}), self._settings.get(number, {}), self._truths.get(number))

    def facts_for(self, transfer: Transfer, number: int) -> FrameFacts:
        """Return the current facts of a frame, completed by those stored when the transfer began, unless these are of
        another frame."""
        kept = transfer.options.get("facts") or {}
        if int(kept.get("info", {}).get("frame_number", number)) != number:
            kept = {}
        now = self.facts(number)
        return FrameFacts(
            now.info or kept.get("info", {}), now.settings or kept.get("settings", {}), now.truth or kept.get("truth")
        )
