"""Upload of stored frames to image memory. On request, the sensor's chain is run on the image, and its results are attached to
the stored frame."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import Direction, HelloReceived, TransferDone
from gss.domain.errors import BadInput, Conflict, GssError
from gss.instruments.dictionary.definitions import Values
from gss.instruments.operations import SLOT, Operation
from gss.operations.commanding.command_record import CommandCompleted
from gss.operations.commanding.commanding import SERVER, SOFTWARE, CommandService
from gss.operations.events import EventBus
from gss.operations.frames.frames import FrameService
from gss.operations.line.line_events import LineBatch
from gss.operations.line.link import LinkService
from gss.operations.transfers.arrivals import ContentArrived
from gss.operations.transfers.device_frames import Shape, wire_bytes
from gss.operations.transfers.transfer_progress import TransferView
from gss.operations.transfers.transfers import TransferService
from gss.store.models import Frame, Transfer

REMEMBERED = 64
CHAIN = (Operation.FIND_CENTROIDS, Operation.MATCH_STARS, Operation.CALCULATE_ATTITUDE)


class UploadedImages:
    """Uploads frames, sends the commands that solve them, and maps images on board to the stored frames."""

    def __init__(
        self,
        link: LinkService,
        commands: CommandService,
        transfers: TransferService,
        frames: FrameService,
        bus: EventBus,
    ) -> None:
        self._link, self._commands, self._bus = link, commands, bus
        self._transfers, self._frames = transfers, frames
        self._frame_of: OrderedDict[str, int] = OrderedDict()
        self._solving: dict[int, int] = {}
        """Command in progress of each solution, and its image: the slot, and after the search for stars the frame's number."""

    def upload(self, frame_id: int, slot: int, *, solve: bool) -> TransferView:
        """Start the upload of a complete frame of the detector's size to an image memory. Raises Conflict or BadInput if the
        upload is not possible."""
        frame, hello = self._frames.get(frame_id), self._link.hello
        if hello is None:
            raise Conflict("no device has answered", got=self._link.reason or "no answer", hint="open the link first")
        if not 0 <= slot < hello.image_slots:
            raise BadInput("unknown image memory", expected=f"0 – {hello.image_slots - 1}", got=str(slot))
        if not frame.complete:
            raise BadInput("the frame is not complete", expected="a complete image", got=frame.name)
        if solve:
            self._check_idle()
        data = wire_bytes(self._frames.pixels(frame), Shape(hello.columns, hello.rows, hello.bits))
        self._remember(hashlib.sha256(data).hexdigest(), frame.id)
        return self._transfers.upload(
            "image",
            slot,
            data,
            _described(hello, self._link.dictionary.hash),
            name=str(slot),
            subject=f"frame {frame.id} to image memory {slot}",
            options={"solve": solve},
            frame_id=frame.id,
        )

    def _check_idle(self) -> None:
        operations = self._link.roles.operations
        for operation in CHAIN:
            name = operations.command(operation)
            command = operations.dictionary.command(name)
            unmet = [s for s in self._commands.preconditions(command) if s.met is False]
            if unmet:
                raise Conflict(
                    f"{name} is not allowed in the current state", expected=unmet[0].text.lower(), got=unmet[0].value
                )

    def _remember(self, sha256: str, frame_id: int) -> None:
        self._frame_of[sha256] = frame_id
        self._frame_of.move_to_end(sha256)
        while len(self._frame_of) > REMEMBERED:
            self._frame_of.popitem(last=False)

    # --- events -------------------------------------------------------------------------------------------------

    def handle(self, batch: LineBatch) -> None:
        """Process completed image uploads and completed commands of a solution."""
        for event in batch.events:
            if (
                isinstance(event, ContentArrived)
                and event.done.direction is Direction.UP
                and event.done.kind == "image"
            ):
                self._sent(event.transfer, event.done)
            elif isinstance(event, CommandCompleted):
                self._completed(event)
            elif isinstance(event, HelloReceived):
                self._solving.clear()  # the next commands of a solution would be unexpected in a new contact

    def _sent(self, transfer: Transfer, done: TransferDone) -> None:
        """Process a completed upload: request the number of the image on board, and then start the solution if it was
        requested."""
        if transfer.frame_id is not None:
            self._remember(done.sha256, transfer.frame_id)
        self._send(
            Operation.LIST_FRAMES, image=int(transfer.options["slot"]) if transfer.options.get("solve") else None
        )

    def frame_of(self, info: Mapping[str, Any]) -> Frame | None:
        """Return the stored frame from which an image on board was uploaded, None for other images."""
        sha256 = info.get("sha256")
        key = sha256.hex() if isinstance(sha256, bytes) else str(sha256)
        if str(info.get("source")) != "uploaded" or key not in self._frame_of:
            return None
        return self._frames.get(self._frame_of[key])

    def _completed(self, event: CommandCompleted) -> None:
        """Send the next command of a solution in progress. A failed command ends the solution, because no next command is
        sent."""
        image = self._solving.pop(event.command_id, None)
        operation = self._link.roles.operations.of_command(event.name, event.arguments)
        if image is None:
            return
        if operation is Operation.LIST_FRAMES:
            self._send(Operation.FIND_CENTROIDS, {SLOT: image}, image=image)
        elif operation is Operation.FIND_CENTROIDS:
            self._send(Operation.MATCH_STARS, image=int(event.values["frame_number"]))
        elif event.values.get("frame_number") == image:
            self._send(Operation.CALCULATE_ATTITUDE)

    def _send(self, operation: Operation, arguments: Values | None = None, *, image: int | None = None) -> None:
        """Send a command. ``image``: the image of the solution to which it belongs, None if no further command follows."""
        try:
            call = self._link.roles.operations.call(operation, arguments)
            row = self._commands.send(call.command, call.arguments, confirm="", user=SOFTWARE, source=SERVER)
        except GssError as error:
            name = self._link.roles.operations.title(operation)
            self._bus.record("command", "warning", f"{name} was not sent: {error}")
            return
        if image is not None:
            self._solving[row.id] = image


def _described(hello: HelloReceived, dictionary_hash: bytes) -> Compatibility:
    return Compatibility(device_model=hello.device_model, profile=hello.profile, dictionary_hash=dictionary_hash)
