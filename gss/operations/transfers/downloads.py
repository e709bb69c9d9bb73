"""Downloads requested by an operator: a whole image, a part of an image, or the content of a bank."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gss.device.protocol.windows import SIDE_RANGE_PX
from gss.device.session_transfer import Part
from gss.domain.dark_columns import DarkColumns
from gss.domain.errors import BadInput, GssError
from gss.operations.line.link import LinkService
from gss.operations.transfers.device_frames import Shape, wire_bytes
from gss.operations.transfers.flash_banks import CATALOGUE_PARTS, family_of
from gss.operations.transfers.transfer_progress import TransferView
from gss.operations.transfers.transfers import StoredContent, TransferService
from gss.store.models import Frame

IMAGE_KINDS = ("frame", "thumbnail", "region", "star_windows")
TABLE_KINDS = ("triplets", "calibration", "parameters", "bad_pixels")
DEFAULT_SIDE_PX = 11
UPLOADED_IMAGE = "image"


def permission_of(kind: str) -> str:
    """Return the permission needed to download a kind of content, or to resume such a transfer in either direction. An
    unknown kind needs an admin permission."""
    if kind in (*IMAGE_KINDS, UPLOADED_IMAGE):
        return "frames.transfer"
    return "catalogues.upload" if kind in CATALOGUE_PARTS else "tables" if kind in TABLE_KINDS else "admin.users"


class StoredFrames(Protocol):
    """Provides the frames of earlier downloads."""

    def newest_in_slot(self, slot: int, bits: int) -> Frame | None: ...

    def picture(self, frame: Frame) -> NDArray[np.generic]: ...

    def dark_columns(self, profile_name: str) -> DarkColumns: ...


class Downloads:
    """Checks download requests before they are sent to the device. An image that is already stored is not downloaded
    again."""

    def __init__(self, link: LinkService, transfers: TransferService, frames: StoredFrames) -> None:
        self._link, self._transfers, self._frames = link, transfers, frames

    def start(
        self,
        kind: str,
        *,
        slot: int | None = None,
        bank: str | None = None,
        region: Part | None = None,
        side_px: int | None = None,
    ) -> TransferView:
        """Queue a download. Raises BadInput if the kind and the other arguments do not fit together."""
        if (region is None) == (kind == "region"):
            raise BadInput("the region and the kind of the download do not match", got=kind)
        if side_px is not None and kind != "star_windows":
            raise BadInput("only the kind star_windows has a side", got=kind)
        subject = kind.replace("_", " ")
        if kind in IMAGE_KINDS:
            number = self._slot(kind, slot, bank)
            part = self._part(kind, region, side_px)
            stored = self._stored(number) if kind == "frame" else None
            return self._transfers.download(kind, number, f"{subject} of slot {number}", part=part, stored=stored)
        name, number = self._bank(kind, slot, bank)
        return self._transfers.download(kind, number, f"{subject} of bank {name}", target=name)

    def _stored(self, slot: int) -> StoredContent | None:
        """Return the latest stored image of a slot, whose hash the device will compare; None if no such image can be
        used."""
        hello = self._link.hello
        frame = self._frames.newest_in_slot(slot, hello.bits) if hello is not None else None
        if hello is None or frame is None or frame.number is None:
            return None
        try:
            dark_columns = self._frames.dark_columns(hello.profile).count
            shape = Shape(hello.columns, hello.rows, hello.bits, dark_columns)
            data = wire_bytes(self._frames.picture(frame), shape)
        except GssError:  # the stored image cannot be used: its pixels were removed, or another sensor took it
            return None
        return StoredContent(frame.id, frame.number, data)

    def _slot(self, kind: str, slot: int | None, bank: str | None) -> int:
        if slot is None or bank is not None:
            raise BadInput(
                f"{kind} is downloaded from an image memory", expected="slot", got=f"bank {bank}" if bank else ""
            )
        hello = self._link.hello
        if hello is not None and slot >= hello.image_slots:
            raise BadInput("unknown image memory", expected=f"0 – {hello.image_slots - 1}", got=str(slot))
        return slot

    def _part(self, kind: str, region: Part | None, side_px: int | None) -> Part | None:
        if kind == "star_windows":
            side, (low, high) = side_px or DEFAULT_SIDE_PX, SIDE_RANGE_PX
            if side % 2 == 0 or not low <= side <= high:
                raise BadInput(
                    "the side of star windows is out of range", expected=f"odd, {low} – {high} px", got=str(side)
                )
            return Part(columns=side)
        hello = self._link.hello
        if region is not None and hello is not None:
            fits = region.col_px + region.columns <= hello.columns and region.row_px + region.rows <= hello.rows
            if not fits or region.columns < 1 or region.rows < 1:
                got = f"{region.columns} x {region.rows} at {region.col_px}, {region.row_px}"
                raise BadInput(
                    "the region extends beyond the detector", expected=f"{hello.columns} x {hello.rows} px", got=got
                )
        return region

    def _bank(self, kind: str, slot: int | None, bank: str | None) -> tuple[str, int]:
        """Return the name of a bank and its number in the protocol."""
        if bank is None or slot is not None:
            raise BadInput(
                f"{kind} is downloaded from a bank", expected="bank", got=f"slot {slot}" if slot is not None else ""
            )
        return bank, family_of(kind).number(self._link.roles.operations, bank)
