"""Interface between the ground and one type of sensor: a driver. Drivers are installed in the entry point group
``gss.drivers``.

A driver is pure: its inputs are bytes and a monotonic time, its outputs are bytes and events. It owns no port, thread
or clock, so the same driver can run on the line, in a test and in a replay. :func:`open_driver` builds the session of
one unit; its owner calls ``link_up`` when a port is open, ``feed`` with received bytes, and ``poll`` every 10–50 ms,
and writes what ``poll`` returns.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import entry_points
from typing import Protocol, cast

from gss.device.protocol.authentication import PacketSigner
from gss.device.protocol.codec import EncodedCommand
from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import (
    CommandUpdate,
    HelloReceived,
    LinkCounters,
    Ranges,
    SessionEvent,
    TransferUpdate,
)
from gss.device.session_transfer import HeldPart, Part
from gss.domain.errors import NotFound
from gss.instruments.dictionary.definitions import Dictionary, Value
from gss.instruments.package import Instrument
from gss.instruments.package_files import DRIVERS, LinkFile

InFlight = tuple[int, EncodedCommand, str | None]
"""(request id, command, serial number of the unit for which it was queued; None: not known)."""


class DriverTransfers(Protocol):
    """Uploads and downloads of a device. A method raises Conflict or NotFound if the request cannot be executed."""

    def start_download(
        self,
        kind: str,
        slot: int,
        *,
        partial: HeldPart | None = None,
        chunk_bytes: int | None = None,
        part: Part | None = None,
        paused: str = "",
        unit: str = "",
    ) -> int: ...

    def start_upload(
        self,
        kind: str,
        target: int,
        data: bytes,
        compatibility: Compatibility,
        *,
        chunk_bytes: int | None = None,
        paused: str = "",
        unit: str = "",
    ) -> int: ...

    def partial(self, transfer_id: int) -> tuple[bytes, Ranges]: ...

    def pause(self, transfer_id: int) -> None: ...

    def resume(self, transfer_id: int) -> None: ...

    def abort(self, transfer_id: int) -> None: ...

    def forget(self, transfer_id: int) -> None: ...

    @property
    def holds_channel(self) -> bool: ...


class Driver(Protocol):
    """Session with one unit. A method that raises BadInput, NotFound or Conflict has no effect. Not thread-safe."""

    framing: str
    """Framing of the line, for display."""
    stores_results: bool
    """True if the sensor stores the results of its latest request ids, and does not execute a repeated id again."""

    @property
    def transfers(self) -> DriverTransfers: ...

    # commands
    def encode(self, name: str, arguments: Mapping[str, Value]) -> EncodedCommand: ...

    def submit(self, order: EncodedCommand, *, request_id: int | None = None) -> int: ...

    def reserve(self) -> int: ...

    def check_allowed(self, name: str) -> None: ...

    def preview(self, order: EncodedCommand) -> list[tuple[str, bytes]]: ...

    def check_retry(self, request_id: int) -> None: ...

    def retry(self, request_id: int, now_s: float) -> None: ...

    def withdraw(self, request_id: int, detail: str) -> CommandUpdate: ...

    def withdraw_all(self, detail: str) -> list[CommandUpdate]: ...

    def abort(self, now_s: float) -> int: ...

    def acknowledge_mismatch(self) -> None: ...

    def restore(self, next_request_id: int, in_flight: Sequence[InFlight], next_transfer_id: int = 1) -> None: ...

    def transfer(self, transfer_id: int) -> TransferUpdate: ...

    # line
    def link_up(self, now_s: float) -> None: ...

    def link_lost(self, now_s: float) -> list[SessionEvent]: ...

    def feed(self, data: bytes, now_s: float) -> list[SessionEvent]: ...

    def poll(self, now_s: float) -> tuple[bytes, list[SessionEvent]]: ...

    # state
    @property
    def counters(self) -> LinkCounters: ...

    @property
    def next_request_id(self) -> int: ...

    @property
    def housekeeping(self) -> Mapping[str, Value] | None: ...

    @property
    def hello(self) -> HelloReceived | None: ...

    @property
    def device_dictionary_hash(self) -> str | None: ...


@dataclass(frozen=True)
class UnitSetup:
    """Configuration of a driver for one unit. ``instrument``: name of the package, assumed as the identity of the unit
    if the protocol does not report one. ``columns``, ``rows``, ``bits``: properties of the detector. ``framing``:
    replaces the framing of ``link`` unless empty."""

    dictionary: Dictionary
    link: LinkFile
    instrument: str = ""
    columns: int = 0
    rows: int = 0
    bits: int = 0
    framing: str = ""
    signer: PacketSigner | None = None

    def identity(self, device_time_s: float) -> HelloReceived:
        """Return the identity of a unit whose protocol does not report one: that of its package."""
        return HelloReceived(
            device_model=self.dictionary.device_model,
            profile=self.instrument,
            firmware="not reported",
            serial="",
            simulated=None,
            dictionary_hash=self.dictionary.hash_hex,
            dictionary_match=True,
            line_baud=self.link.baud,
            columns=self.columns,
            rows=self.rows,
            bits=self.bits,
            image_slots=0,
            bank_bytes=0,
            boot_count=0,
            last_request_id=0,
            device_time_s=device_time_s,
        )


Factory = Callable[[UnitSetup], Driver]


@lru_cache(maxsize=16)
def driver_named(name: str) -> Factory:
    """Return the session factory of an installed driver. Raises NotFound."""
    installed = entry_points(group=DRIVERS)
    if name not in installed.names:
        raise NotFound("unknown driver", expected=" | ".join(sorted(installed.names)), got=name)
    return cast(Factory, installed[name].load())


def open_driver(instrument: Instrument, framing: str = "", signer: PacketSigner | None = None) -> Driver:
    """Create a session with a unit of an instrument. Raises NotFound for an unknown driver, BadInput for a
    ``link.yaml`` that the driver cannot use."""
    camera = instrument.profile.camera
    setup = UnitSetup(
        instrument.dictionary,
        instrument.link,
        instrument.name,
        camera.columns,
        camera.rows,
        instrument.profile.sensor.bits,
        framing,
        signer,
    )
    return driver_named(instrument.about.driver)(setup)
