"""Content that can be downloaded from the device: whole and partial images, banks, sections of banks, tables."""

from __future__ import annotations

from collections.abc import Mapping

from gss.catalogue_tools.onboard import HEADER_BYTES, core_bytes, read_header
from gss.device.protocol.windows import encode_windows, windows_round
from gss.device.simulator.bank_writer import FLASH_KINDS, BankWriter
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.images import StoredFrame, frame_bytes, thumbnail
from gss.device.simulator.memory import Memory
from gss.device.simulator.rejection import Rejection
from gss.domain.errors import BadInput, CorruptData
from gss.instruments.dictionary.definitions import Value

SECTIONS = ("star_list", "distance_table")


class DownloadSource:
    """Provides content for downloads by kind and target."""

    def __init__(self, memory: Memory, tracker: StarTracker, writer: BankWriter) -> None:
        self._memory, self._tracker, self._writer = memory, tracker, writer

    def content(self, request: Mapping[str, Value]) -> tuple[bytes, int]:
        """Return the bytes and the frame number (0 if not an image) for an OPEN_DOWNLOAD. Raises Rejection."""
        kind, target = str(request["kind"]), int(request["target"])
        if kind in FLASH_KINDS:
            return self._flash(self._writer.area(kind, target)), 0
        if kind in SECTIONS:
            return self._section(kind, self._flash(self._writer.area("catalogue", target))), 0
        frame = self._tracker.imager.stored(target)
        if kind == "region":
            return self._region(frame, request), frame.number
        if kind == "star_windows":
            return self._windows(frame, int(request["columns"])), frame.number
        return (frame_bytes(thumbnail(frame.pixels)) if kind == "thumbnail" else frame.data), frame.number

    def _flash(self, area: str) -> bytes:
        if self._memory.record.banks[area].state not in ("committed", "corrupt"):
            raise Rejection("bank_empty", f"{area} is {self._memory.record.banks[area].state}")
        return self._memory.content(area)

    def _section(self, kind: str, image: bytes) -> bytes:
        """Return the stars or pairs of a bank image, in the bank's format. Raises Rejection if the format has no
        pairs."""
        try:
            header = read_header(image)
        except CorruptData as error:
            raise Rejection("bank_corrupt", str(error)) from error
        end = core_bytes(header.format_name, header.stars, 0)
        total = core_bytes(header.format_name, header.stars, header.pairs)
        if kind == "distance_table" and total == end:
            raise Rejection("not_found", f"the bank has no distance table, its format is {header.format_name}")
        return image[HEADER_BYTES:end] if kind == "star_list" else image[end:total]

    @staticmethod
    def _region(frame: StoredFrame, request: Mapping[str, Value]) -> bytes:
        col, row, columns, rows = (int(request[n]) for n in ("col_px", "row_px", "columns", "rows"))
        height, width = frame.pixels.shape
        if not (columns and rows and col + columns <= width and row + rows <= height):
            got = f"{columns} x {rows} from ({col}, {row})"
            raise Rejection("out_of_range", f"the image has {width} x {height} px, requested {got}")
        return frame_bytes(frame.pixels[row : row + rows, col : col + columns])

    def _windows(self, frame: StoredFrame, side_px: int) -> bytes:
        """Return windows around the centroids of the image; detects the centroids first if necessary."""
        tracker = self._tracker
        if tracker.frame is not frame or tracker.detection is None:
            tracker.keep(frame, *tracker.detect(frame))
        assert tracker.detection is not None  # noqa: S101 - just found
        height, width = frame.pixels.shape
        centres = [(float(c), float(r)) for c, r in tracker.detection.centroids.pixels]
        try:
            return encode_windows(frame.pixels, windows_round(centres, side_px, width, height))
        except BadInput as error:
            raise Rejection("out_of_range", str(error)) from error
