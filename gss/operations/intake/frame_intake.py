"""Intake of frames from the device. New frames are downloaded and stored with all available data about them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

from gss.device.session_events import Direction, HelloReceived, Telemetry, TransferState
from gss.device.session_transfer import Part
from gss.domain.errors import GssError
from gss.domain.json_object import JsonObject
from gss.instruments.operations import Operation
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.frames.frames import FrameService
from gss.operations.intake.frame_records import FrameFacts, FrameRecords
from gss.operations.intake.uploaded_images import UploadedImages
from gss.operations.line.clock_correlation import Correlation
from gss.operations.line.line_events import LineBatch
from gss.operations.line.link import LinkService
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.transfers.arrivals import ContentArrived, Later, Links, PartArrived, Writer
from gss.operations.transfers.device_frames import DeviceImage, picture_of, shape_of
from gss.operations.transfers.transfers import TransferService
from gss.store.models import Frame, Transfer

IMAGE_KINDS = ("frame", "thumbnail", "region", "star_windows")
SHOWN_IN_PARTS = ("frame", "region")


class FrameIntake:
    """Downloads the latest frame that the device reports, one frame at a time, and stores received frames.

    ``automatic``: False to download frames only on request. ``clock``: returns the correlation of the device's clock with the
    ground's clock, None if there is none.
    """

    def __init__(
        self,
        link: LinkService,
        telemetry: TelemetryService,
        transfers: TransferService,
        frames: FrameService,
        images: UploadedImages,
        records: FrameRecords,
        writer: Writer,
        clock: Callable[[], Correlation | None],
        bus: EventBus,
        now: Now,
        *,
        automatic: bool = True,
    ) -> None:
        self._link, self._telemetry, self._transfers, self._frames = link, telemetry, transfers, frames
        self._images, self._records, self._writer = images, records, writer
        self._clock, self._bus, self._now = clock, bus, now
        self._requested: tuple[int, int] | None = None
        self._refused, self._automatic = "", automatic

    def handle(self, batch: LineBatch) -> None:
        """Process HELLO reports, descriptions of frames, and received content."""
        quantities = self._link.roles.quantities
        for event in batch.events:
            if isinstance(event, HelloReceived):
                self._records.forget()
            elif isinstance(event, Telemetry) and event.packet == quantities.frame.packet:
                self._described(quantities.frame.read(event.values))
            elif isinstance(event, Telemetry) and event.packet == quantities.truth.packet:
                truth = quantities.truth.read(event.values)
                quaternion = [float(truth[f"quaternion_{axis}"]) for axis in "xyzw"]
                self._records.true_attitude(int(truth["frame_number"]), quaternion)
            elif isinstance(event, ContentArrived) and event.done.direction is Direction.DOWN:
                self._arrived(event)
            elif isinstance(event, PartArrived) and event.transfer.kind in SHOWN_IN_PARTS:
                self._part_arrived(event)
        self._fetch_requested()

    def _described(self, info: Mapping[str, Any]) -> None:
        number = int(info["frame_number"])
        if not self._records.described(number, info):
            return
        is_time, taken = self._link.roles.quantities.frame.number_is_time, self._taken(info)
        if is_time and taken is not None and self._frames.has_number(number, taken):
            return
        sent = self._images.frame_of(info)
        if sent is not None:
            self._records.stored(number, self._as_on_board(sent, number, info))
        elif self._automatic and self._link.roles.operations.has(Operation.DOWNLOAD_FRAME):
            self._requested = (number, int(info.get("slot", 0)))

    def _as_on_board(self, sent: Frame, number: int, info: Mapping[str, Any]) -> Frame:
        """Return a copy of an uploaded frame's row with the camera, exposure and settings that the sensor uses for it. The stored
        row is not changed."""
        settings, hello = dict(self._records.facts(number).settings), self._link.hello
        values = {column.name: getattr(sent, column.name) for column in Frame.__table__.columns}
        on_board = {
            "number": number,
            "profile": hello.profile if hello else sent.profile,
            "exposure_s": float(info["exposure_ms"]) / 1000,
            "bank_sha256": settings.get("bank_sha256"),
            "parameters": settings,
        }
        return Frame(**(values | on_board))

    def _fetch_requested(self) -> None:
        """Start the download of the latest reported frame if no download is in progress. Earlier frames that are still waiting
        are not downloaded."""
        if self._requested is None or not self._link.connected or self._transfers.busy(Direction.DOWN):
            return
        number, slot = self._requested
        self._requested = None
        try:
            facts = self._records.facts(number).plain()
            self._transfers.download("frame", slot, f"frame {number}", facts=facts)
            self._refused = ""
        except GssError as error:
            # A full disk causes the same error for all frames, so the error is reported once.
            if error.message != self._refused:
                self._bus.record("transfer", "watch", f"Frame {number} was not fetched: {error}")
            self._refused = error.message

    # --- content ------------------------------------------------------------------------------------------------

    def _arrived(self, event: ContentArrived) -> None:
        if event.done.kind in IMAGE_KINDS:
            transfer, done = event.transfer, event.done
            if self._requested is not None and done.kind == "frame" and self._requested[0] == done.frame_number:
                self._requested = None  # the download began later than requested and received this newer image
            frame_id = _stored_before(transfer, done.sha256, done.frame_number)
            if frame_id is not None:
                event.answers.accept(lambda: {"frame_id": frame_id})
                return
            number = done.frame_number or _number_at_start(transfer)
            if self._content_is_file:
                event.answers.accept(lambda: self._store_file(transfer, done.data, number))
            else:
                event.answers.accept(lambda: self._store(transfer, done.data, number, []))

    @property
    def _content_is_file(self) -> bool:
        operations = self._link.roles.operations
        row = operations.require(Operation.DOWNLOAD_FRAME) if operations.has(Operation.DOWNLOAD_FRAME) else None
        return row is not None and row.content == "image_file"

    def _part_arrived(self, event: PartArrived) -> None:
        """Store the received part of an interrupted download. It is stored once while the download can still continue,
        and once when the download has ended."""
        transfer, update = event.transfer, event.update
        if self._content_is_file or (transfer.frame_id is not None and update.state is TransferState.LINK_LOST):
            return  # a part of a file cannot be displayed
        if (transfer.options.get("stored") or {}).get("sha256") == update.sha256:
            return  # all data of this part come from the frame that was already stored and was offered to the device
        held_bytes = [(a * update.chunk_size, (b + 1) * update.chunk_size) for a, b in event.ranges]
        event.answers.accept(lambda: self._store(transfer, event.data, update.frame_number, held_bytes))

    def _store(self, transfer: Transfer, data: bytes, number: int, held_bytes: Sequence[tuple[int, int]]) -> Later:
        """Prepare the frame's row from the current data, and return the task in which the writer stores the pixels."""
        hello, kind, facts = self._link.hello, transfer.kind, self._records.facts_for(transfer, number)
        dark_columns = self._frames.dark_columns(hello.profile).count if hello else 0
        shape = shape_of(facts.info, *((hello.columns, hello.rows, hello.bits) if hello else (0, 0, 0)), dark_columns)
        part = Part(**transfer.options["part"]) if transfer.options.get("part") else None
        picture = picture_of(kind, data, shape, part, held_bytes)
        values = self._row_values(transfer, number, facts) | {
            "bits": shape.bits,
            "complete": picture.complete,
            "rows_held": [list(rows) for rows in picture.rows_held],
            "parameters": _parameters(facts) | _part_of(kind, picture),
        }
        return self._later(kind, number, lambda: self._frames.add_from_device(picture.pixels, values))

    def _store_file(self, transfer: Transfer, data: bytes, number: int) -> Later:
        """Prepare the row of a frame that was received as an image file, and return the task in which the writer reads and stores
        the file."""
        facts = self._records.facts_for(transfer, number)
        values = self._row_values(transfer, number, facts)

        def work() -> Frame:
            image = self._frames.read_image(data, str(values["name"]))
            return self._frames.add_from_device(image.pixels, values | {"bits": image.bits})

        return self._later(transfer.kind, number, work)

    def _row_values(self, transfer: Transfer, number: int, facts: FrameFacts) -> dict[str, object]:
        """Return the columns of a frame's row that do not depend on its pixels."""
        hello, kind, info, settings = self._link.hello, transfer.kind, facts.info, facts.settings
        taken = self._taken(info)
        return {
            "contact_id": self._link.contact_id or transfer.contact_id,
            "number": number or None,
            "slot": int(transfer.target),
            "name": _name(kind, number),
            "taken": taken or self._now(),
            "time_known": taken is not None,
            "exposure_s": float(info["exposure_ms"]) / 1000 if "exposure_ms" in info else None,
            "profile": hello.profile if hello and kind != "thumbnail" else None,
            "mode": str(info["mode"]) if "mode" in info else None,
            "truth": facts.truth,
            "bank_sha256": settings.get("bank_sha256"),
            "parameters": _parameters(facts),
        }

    def _later(self, kind: str, number: int, work: Callable[[], Frame]) -> Later:
        starts = self._records.device_starts
        return Later(
            self._writer.submit,
            work,
            lambda frame: self._stored(kind, number, frame, fresh=starts == self._records.device_starts),
        )

    def _stored(self, kind: str, number: int, frame: Frame, *, fresh: bool) -> Links:
        """Record a stored frame, and return the links from the transfer's row to it. ``fresh``: False if the device has restarted
        since the frame arrived, because it can then reuse the number."""
        if kind == "frame" and frame.complete and fresh:
            self._records.stored(number, frame)
        return {"frame_id": frame.id}

    def _taken(self, info: Mapping[str, Any]) -> datetime | None:
        """Return the mid-exposure time of a frame on the ground's clock, None if the device did not report it. It is calculated
        from the correlation of the clocks. If there is no correlation, it is calculated relative to the latest housekeeping
        packet."""
        now = self._now()
        newest = self._telemetry.latest_packet(self._link.roles.quantities.status.packet)
        if newest is None or not newest.device_time_s or "frame_time_s" not in info:
            return None
        correlation = self._clock()
        if correlation is not None:
            # If one correlation is used for all frames of a contact, their times keep the intervals of the device's
            # clock.
            return min(now, datetime.fromtimestamp(correlation.utc_of(float(info["frame_time_s"])), UTC))
        return now - timedelta(seconds=max(0.0, newest.device_time_s - float(info["frame_time_s"])))


def _name(kind: str, number: int) -> str:
    return f"frame {number}" if kind == "frame" else f"{kind.replace('_', ' ')} of frame {number}"


def _number_at_start(transfer: Transfer) -> int:
    """Return the number of the frame that was stored with the transfer at its start, 0 if there is none."""
    facts = transfer.options.get("facts") or {}
    return int((facts.get("info") or {}).get("frame_number", 0))


def _stored_before(transfer: Transfer, sha256: str, frame_number: int) -> int | None:
    """Return the id of the stored frame that was offered to the device if the device has the same image, otherwise None."""
    offered = transfer.options.get("stored") or {}
    same = (offered.get("sha256"), offered.get("frame_number")) == (sha256, frame_number)
    return int(offered["frame_id"]) if same else None


def _parameters(facts: FrameFacts) -> JsonObject:
    """Return the settings without the bank, which has a separate column."""
    return {name: value for name, value in facts.settings.items() if name != "bank_sha256"}


def _part_of(kind: str, picture: DeviceImage) -> dict[str, object]:
    """Return the kind of a partial image and its received rectangles, {} for a complete frame."""
    return {} if kind == "frame" else {"part": kind, "held": [list(box) for box in picture.boxes]}
