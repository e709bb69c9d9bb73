"""An open transfer on the device, and a transfer message to send."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from gss.device.protocol.transfer import ChunkReceiver, ChunkSender
from gss.instruments.dictionary.definitions import Value

WINDOW_CHUNKS = 16


@dataclass(frozen=True)
class Outgoing:
    """A transfer message to send."""

    service: str
    request_id: int
    values: Mapping[str, Value]
    lists: Mapping[str, list[Mapping[str, Value]]] = field(default_factory=dict)


@dataclass
class Session:
    """One open transfer. Exactly one of ``receiver`` (upload) and ``sender`` (download) is set.

    ``area``: the flash area that an upload writes, "" for images. ``offered``: stars, pairs and epoch that the ground
    stated for a catalogue, by name, without values that it did not state.
    """

    id: int
    request_id: int
    kind: str
    target: int
    size: int
    chunk_bytes: int
    sha256: bytes
    data: bytearray
    received_s: float
    resumed: bool
    frame_number: int = 0
    receiver: ChunkReceiver | None = None
    sender: ChunkSender | None = None
    committed: bool = False
    area: str = ""
    offered: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name for display."""
        return self.area or f"{self.kind} {self.target}"
