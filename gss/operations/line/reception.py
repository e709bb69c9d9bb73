"""What comes down by itself: frames are fetched when taken, packets of one frame are gathered, unknown banks are read back.

This is the glue between link, transfers, frames and banks; each of them knows nothing of the others.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from gss.device.session import Part
from gss.device.session_events import (
    DeviceEvent,
    Direction,
    HelloReceived,
    Telemetry,
    TransferDone,
    TransferState,
    TransferUpdate,
)
from gss.domain.errors import GssError
from gss.domain.stars import StarTable
from gss.operations.clock import Now
from gss.operations.commanding.commanding import CommandService
from gss.operations.events import EventBus
from gss.operations.frames.frame_memory import FrameMemory, remember
from gss.operations.frames.frames import FrameService
from gss.operations.frames.onboard_results import OnboardRecord
from gss.operations.frames.replay import ReplayService
from gss.operations.line.clock_correlation import Correlation
from gss.operations.line.line_events import LineBatch
from gss.operations.line.link import LinkService
from gss.operations.line.sensor_knowledge import SensorKnowledge
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.transfers.arrivals import Later
from gss.operations.transfers.banks import BankService
from gss.operations.transfers.device_frames import Picture, picture_of, shape_of
from gss.operations.transfers.device_tables import FACTORY, DeviceTableService
from gss.operations.transfers.transfers import TransferService
from gss.operations.transfers.uploaded_images import UploadedImages
from gss.store.models import Frame, Transfer

FRAME_PACKETS = ("centroids", "matches", "attitude")
IMAGE_KINDS = ("frame", "thumbnail", "region", "star_windows")
AFTER_HELLO = ("LIST_BANKS", "LIST_TABLES", "GET_STATUS")
SOFTWARE = "gss"


class Reception:
    """Listens to the link and moves what arrives to where it belongs."""

    def __init__(
        self,
        link: LinkService,
        commands: CommandService,
        telemetry: TelemetryService,
        transfers: TransferService,
        frames: FrameService,
        banks: BankService,
        tables: DeviceTableService,
        images: UploadedImages,
        replay: ReplayService,
        stars: StarTable,
        bus: EventBus,
        now: Now,
    ) -> None:
        self._link, self._commands, self._telemetry = link, commands, telemetry
        self._transfers, self._frames, self._banks = transfers, frames, banks
        self._tables, self._images = tables, images
        self._replay, self._stars, self._bus, self._now = replay, stars, bus, now
        self._records: OrderedDict[int, OnboardRecord] = OrderedDict()
        self._known = FrameMemory()
        self._stored: OrderedDict[int, Frame] = OrderedDict()
        self._wanted: tuple[int, int] | None = None
        self._unfetched = ""
        self._device_starts = 0
        self._knowledge = SensorKnowledge(link.dictionary)
        self.clock: Callable[[], Correlation | None] = lambda: None
        """How the two clocks stand; set by whoever follows them."""
        commands.completed_hooks.append(self._command_completed)
        tables.ask_device = lambda: self._ask("LIST_TABLES")
        for kind in IMAGE_KINDS:
            transfers.done_hooks[(Direction.DOWN, kind)] = self._frame_arrived
        transfers.done_hooks[(Direction.DOWN, "catalogue")] = self._bank_arrived
        transfers.done_hooks[(Direction.UP, "catalogue")] = self._bank_sent
        transfers.done_hooks[(Direction.UP, "image")] = images.sent
        for kind in ("frame", "region"):
            transfers.broken_hooks[kind] = self._frame_broken

    def handle(self, batch: LineBatch) -> None:
        """Look at each event once."""
        for event in batch.events:
            if isinstance(event, HelloReceived):
                self._greet(event)
            elif isinstance(event, Telemetry):
                self._packet(event)
            elif isinstance(event, DeviceEvent) and event.name == "BANK_FELL_BACK":
                self._ask("LIST_BANKS")
            elif isinstance(event, DeviceEvent) and event.name == "TABLE_FELL_BACK":
                self._ask("LIST_TABLES")
        self._fetch_wanted()

    def _greet(self, hello: HelloReceived) -> None:
        """A device that restarted counts its frames anew: forget what was gathered, ask what it holds."""
        self._device_starts += 1
        for memory in (self._records, self._stored):
            memory.clear()
        self._known.forget()
        self._banks.forget()
        self._tables.forget()
        if hello.dictionary_match:
            self._ask(*AFTER_HELLO)

    def _ask(self, *names: str) -> None:
        for name in names:
            try:
                self._commands.send(name, {}, confirm="", user=SOFTWARE, source="server")
            except GssError as error:
                self._bus.record("link", "watch", f"{name} was not asked: {error}")

    # --- packets ------------------------------------------------------------------------------------------------

    def _packet(self, packet: Telemetry) -> None:
        values = packet.values
        if packet.packet == "bank_info":
            self._bank_told(values)
        elif packet.packet == "table_info":
            if self._tables.told(values):
                # The factory's table came with the unit: no upload brought it, even one with the same bytes.
                brought = "" if str(values["bank"]) == FACTORY else _hex(values["sha256"])
                self._transfers.in_use(str(values["table"]), brought)
        elif packet.packet == "frame_info":
            self._frame_told(values)
        elif packet.packet == "frame_truth":
            self._known.true_attitude(int(values["frame_number"]), [float(values[f"quaternion_{a}"]) for a in "xyzw"])
        elif packet.packet in FRAME_PACKETS:
            self._result_told(packet.packet, int(values["frame_number"]), values, packet.lists.get("items", ()))

    def _frame_told(self, info: Mapping[str, Any]) -> None:
        number = int(info["frame_number"])
        if not self._known.told(number, info, self._detection_settings()):
            return
        sent = self._images.frame_of(info)
        if sent is not None:
            remember(self._stored, number, self._as_on_board(sent, number, info))
        else:
            self._wanted = (number, int(info["slot"]))

    def _as_on_board(self, sent: Frame, number: int, info: Mapping[str, Any]) -> Frame:
        """A frame that was sent up, with what the sensor works with: camera, exposure, settings. The stored row stays."""
        settings, hello = dict(self._known.facts(number).settings), self._link.hello
        values = {column.name: getattr(sent, column.name) for column in Frame.__table__.columns}
        own = {
            "number": number,
            "profile": hello.profile if hello else sent.profile,
            "exposure_s": float(info["exposure_ms"]) / 1000,
            "bank_sha256": settings.pop("bank_sha256", None),
            "parameters": settings,
        }
        return Frame(**(values | own))

    def _detection_settings(self) -> dict[str, Any]:
        housekeeping = self._link.session.housekeeping or {}
        names = ("threshold_dn", "min_pixels", "max_pixels")
        settings: dict[str, Any] = {name: housekeeping[name] for name in names if name in housekeeping}
        sha256 = housekeeping.get("catalogue_sha256")
        if sha256 is not None:
            settings["bank_sha256"] = sha256.hex() if isinstance(sha256, bytes) else str(sha256)
        tables = self._tables.at_work()
        return settings | ({"tables": tables} if tables else {})

    def _result_told(self, kind: str, number: int, values: Mapping[str, Any], items: Any) -> None:
        record = self._records.get(number) or OnboardRecord(number)
        hips = self._banks.hip_of_row(self._detection_settings().get("bank_sha256", ""))
        record = record.with_packet(kind, values, items)
        record = replace(record, hip_of_row=hips, icrs_of_hip=self._stars)
        if kind == "attitude":
            record = replace(record, prior=self._knowledge.known)
            solved = values.get("outcome") == "solved"
            found = np.array([float(values[f"quaternion_{a}"]) for a in "xyzw"]) if solved else None
            self._knowledge.iterated(found)
        remember(self._records, number, record)
        if number in self._stored:
            self._lay_beside(self._stored[number], record)

    def _command_completed(self, name: str, arguments: Mapping[str, Any], values: Mapping[str, Any]) -> None:
        """A command may change what the sensor knows, or what its flash holds."""
        self._knowledge.completed(name, arguments)
        if name.endswith("_BANK"):
            self._ask("LIST_BANKS")
        elif name.endswith("_TABLE"):
            self._ask("LIST_TABLES")
        self._images.completed(name, arguments, values)

    # --- frames -------------------------------------------------------------------------------------------------

    def _fetch_wanted(self) -> None:
        """Fetch the newest frame that was told of, one at a time; older ones that were overtaken stay on board."""
        if self._wanted is None or not self._link.connected or self._transfers.busy(Direction.DOWN):
            return
        number, slot = self._wanted
        self._wanted = None
        try:
            self._transfers.download("frame", slot, f"frame {number}", facts=self._known.facts(number).plain())
            self._unfetched = ""
        except GssError as error:
            if error.message != self._unfetched:  # a full disk says the same of every frame: once is enough
                self._bus.record("transfer", "watch", f"frame {number} was not fetched: {error}")
            self._unfetched = error.message

    def _frame_arrived(self, transfer: Transfer, done: TransferDone) -> Later:
        return self._store_frame(transfer, done.data, done.frame_number, [])

    def _frame_broken(
        self, transfer: Transfer, data: bytes, held: Sequence[tuple[int, int]], update: TransferUpdate
    ) -> Later | dict[str, Any]:
        """What a broken transfer brought is shown, once while it may go on and once when it has ended."""
        if transfer.frame_id is not None and update.state is TransferState.LINK_LOST:
            return {}
        held_bytes = [(a * update.chunk_size, (b + 1) * update.chunk_size) for a, b in held]
        return self._store_frame(transfer, data, update.frame_number, held_bytes)

    def _store_frame(
        self, transfer: Transfer, data: bytes, number: int, held_bytes: Sequence[tuple[int, int]]
    ) -> Later:
        """Everything that is known now goes into the row; the bytes go to their store beside the line."""
        hello, kind, facts = self._link.hello, transfer.kind, self._known.facts_for(transfer, number)
        info, settings = facts.info, dict(facts.settings)
        shape = shape_of(info, *((hello.columns, hello.rows, hello.bits) if hello else (0, 0, 0)))
        part = Part(**transfer.options["part"]) if transfer.options.get("part") else None
        picture = picture_of(kind, data, shape, part, held_bytes)
        values = {
            "contact_id": self._link.contact_id or transfer.contact_id,
            "number": number or None,
            "slot": int(transfer.target),
            "name": _name(kind, number),
            "taken": self._taken(info),
            "bits": shape.bits,
            "exposure_s": float(info["exposure_ms"]) / 1000 if "exposure_ms" in info else None,
            "profile": hello.profile if hello and kind != "thumbnail" else None,
            "mode": str(info["mode"]) if "mode" in info else None,
            "complete": picture.complete,
            "rows_held": [list(rows) for rows in picture.rows_held],
            "truth": facts.truth,
            "bank_sha256": settings.pop("bank_sha256", None),
            "parameters": settings | _part_of(kind, picture),
        }
        started = self._device_starts
        return self._transfers.later(
            lambda: self._frames.add_from_device(picture.pixels, values),
            lambda frame: self._frame_stored(kind, number, frame, fresh=started == self._device_starts),
        )

    def _frame_stored(self, kind: str, number: int, frame: Frame, *, fresh: bool) -> dict[str, Any]:
        """``fresh``: the device has not restarted since it came, so that its number is still its own."""
        if kind == "frame" and frame.complete and fresh:
            remember(self._stored, number, frame)
            if number in self._records:
                self._lay_beside(frame, self._records[number])
        return {"frame_id": frame.id}

    def _taken(self, info: Mapping[str, Any]) -> Any:
        """The device's mid-exposure time put on the ground's clock, by the correlation of the clocks, or before there is one by the
        difference to its newest housekeeping."""
        now = self._now()
        newest = self._telemetry.latest_packet("housekeeping")
        if newest is None or "frame_time_s" not in info:
            return now
        clock = self.clock()
        if clock is not None:
            # The same clock for all frames of a contact: they keep the distances that the device's own clock gives them.
            return min(now, datetime.fromtimestamp(clock.utc_of(float(info["frame_time_s"])), UTC))
        return now - timedelta(seconds=max(0.0, newest.device_time_s - float(info["frame_time_s"])))

    def _lay_beside(self, frame: Frame, record: OnboardRecord) -> None:
        if not record.centroids:
            return
        solution = self._frames.add_on_board(frame, record)
        if record.attitude is not None:
            self._replay.queue(frame, record, solution)

    # --- banks --------------------------------------------------------------------------------------------------

    def _bank_told(self, info: Mapping[str, Any]) -> None:
        unknown = self._banks.told(info)
        if info["active"]:
            self._transfers.in_use("catalogue", _hex(info["sha256"]))
        if unknown is not None and not self._transfers.busy(Direction.DOWN):
            try:
                self._transfers.download("catalogue", unknown, f"content of bank {info['bank']}")
            except GssError as error:
                self._bus.record("transfer", "watch", f"bank {info['bank']} was not read back: {error}")

    def _bank_arrived(self, transfer: Transfer, done: TransferDone) -> Later:
        return self._transfers.later(
            lambda: self._banks.adopt(done.data), lambda kept: {"catalogue_id": kept.id} if kept else {}
        )

    def _bank_sent(self, transfer: Transfer, _done: TransferDone) -> dict[str, Any]:
        self._bus.record(
            "catalogue", "ok", f"{transfer.subject} is committed in bank {transfer.target}", transfer_id=transfer.id
        )
        self._ask("LIST_BANKS")
        return {}


def _hex(value: Any) -> str:
    return value.hex() if isinstance(value, bytes) else str(value)


def _name(kind: str, number: int) -> str:
    return f"frame {number}" if kind == "frame" else f"{kind.replace('_', ' ')} of frame {number}"


def _part_of(kind: str, picture: Picture) -> dict[str, Any]:
    """What kind of part of an image this is, and the rectangles that are real."""
    return {} if kind == "frame" else {"part": kind, "held": [list(box) for box in picture.boxes]}
