"""Write uploads to flash: checks before writing, chunks stored by an earlier attempt, and the commit."""

from __future__ import annotations

from collections.abc import Mapping

from gss.catalogue_tools.formats import triplet_table as triplets
from gss.catalogue_tools.onboard import FORMATS, decode, read_header
from gss.device.protocol.chunk_size import regrid
from gss.device.protocol.transfer import ChunkReceiver, chunk_count
from gss.device.simulator.flash_record import area_name
from gss.device.simulator.memory import (
    BANKS,
    FACTORY,
    GOLDEN,
    TABLE_BANKS,
    TABLES,
    BankRecord,
    Memory,
    SuspendedUpload,
)
from gss.device.simulator.rejection import Rejection
from gss.device.simulator.sessions import WINDOW_CHUNKS, Session
from gss.device.table_use import calibrated, check_bad_pixels, check_parameters
from gss.device.tables import BAD_PIXELS, TABLE_FORMAT, decode_bad_pixels, decode_table
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput, CorruptData
from gss.instruments.dictionary.definitions import Dictionary, Value

EPOCHS_JYEAR = (1800.0, 2300.0)
FLASH_KINDS = ("catalogue", *TABLES)


def _short(value: Value) -> str:
    return value.hex()[:8] if isinstance(value, bytes) else str(value)


class BankWriter:
    """Writes the flash of one device. Raises Rejection if a write is not allowed. The caller must save the record after
    ``open``."""

    def __init__(self, dictionary: Dictionary, memory: Memory, profile: CameraProfile) -> None:
        self._dictionary, self._memory, self._profile = dictionary, memory, profile
        self._table_banks = {c.value: c.name for c in dictionary.command("VERIFY_TABLE").argument("bank").choices}

    # --- checks before writing ----------------------------------------------------------------------------------

    def area(self, kind: str, target: int) -> str:
        """Return the name of the flash area for a kind of content and a target number. Raises Rejection."""
        if kind == "catalogue":
            if target >= len(BANKS):
                raise Rejection("not_found", f"banks are 0 – {len(BANKS) - 1}, got {target}")
            return BANKS[target]
        bank = self._table_banks.get(target)
        if bank not in TABLE_BANKS:
            raise Rejection("not_found", f"banks of tables are 0 (A), 1 (B) and 3 (factory); got {target}")
        return area_name(kind, bank)

    def check(self, offer: Mapping[str, Value], target: int, size: int) -> str:
        """Return the name of the area to write. Raises Rejection if the content must not be written to it."""
        kind = str(offer["kind"])
        area = self.area(kind, target)
        if area == GOLDEN or area.endswith(FACTORY):
            raise Rejection("write_protected", f"{area} cannot be written")
        if area in self._in_use(kind):
            raise Rejection("bank_active", f"{area} is in use")
        capacity = self._memory.capacity(area)
        if size > capacity:
            raise Rejection("too_large", f"{area} has {capacity} B, got {size}")
        if not size:
            raise Rejection("bad_length", "the content is empty")
        epoch_jyear = float(offer["epoch_jyear"])
        if epoch_jyear and not EPOCHS_JYEAR[0] <= epoch_jyear <= EPOCHS_JYEAR[1]:
            low, high = EPOCHS_JYEAR
            raise Rejection("out_of_range", f"epoch_jyear: 0 or {low:g} – {high:g}, got {epoch_jyear:g}")
        unit_values: dict[str, Value] = {
            "device_model": self._dictionary.device_model,
            "profile": self._profile.name,
            "dictionary_hash": self._dictionary.hash,
        }
        for name, unit_value in unit_values.items():
            if offer[name] != unit_value:
                raise Rejection("incompatible", f"{name}: expected {_short(unit_value)}, got {_short(offer[name])}")
        if int(offer["format_version"]) not in self.formats(kind):
            expected = " or ".join(map(str, self.formats(kind)))
            raise Rejection("incompatible", f"format_version: expected {expected}, got {int(offer['format_version'])}")
        return area

    @staticmethod
    def offered(offer: Mapping[str, Value]) -> dict[str, float]:
        """Return the properties that the ground stated for a catalogue; zero means not stated."""
        if offer["kind"] != "catalogue":
            return {}
        return {name: float(offer[name]) for name in ("stars", "pairs", "epoch_jyear") if offer[name]}

    def formats(self, kind: str) -> tuple[int, ...]:
        """Return the format versions that the unit reads for a kind of content."""
        if kind == "catalogue":
            return tuple(FORMATS[name] for name in self._profile.formats)
        return (triplets.HEADER_VERSION,) if kind == "triplets" else (TABLE_FORMAT,)

    def _in_use(self, kind: str) -> tuple[str, ...]:
        record = self._memory.record
        if kind == "catalogue":
            return (record.active, record.previous) if record.unconfirmed else (record.active,)
        used = record.tables[kind]
        return tuple(area_name(kind, b) for b in ((used.active, used.previous) if used.unconfirmed else (used.active,)))

    # --- writing ------------------------------------------------------------------------------------------------

    def open(self, area: str, size: int, chunk_bytes: int, digest: bytes) -> tuple[ChunkReceiver, bool]:
        """Prepare an area for writing. Returns a receiver with the stored chunks, and True if an earlier attempt is
        resumed.

        An interrupted attempt resumes with any chunk size; different content starts from an erased area.
        """
        record = self._memory.record
        upload = record.uploads.get(area)
        same = upload is not None and (upload.size, upload.sha256) == (size, digest.hex())
        complete = record.banks[area].sha256 == digest.hex() and self._memory.intact(area)
        numbers: list[int] = []
        if complete:
            numbers = list(range(chunk_count(size, chunk_bytes)))
        elif same and upload is not None:
            numbers = regrid(upload.held, size, upload.chunk_bytes, chunk_bytes)
        else:
            self._memory.erase_bank(area)
        receiver = ChunkReceiver(size, chunk_bytes, WINDOW_CHUNKS, numbers)
        if not complete:
            record.banks[area] = BankRecord("loading", size=size)
            record.uploads[area] = SuspendedUpload(size, chunk_bytes, digest.hex(), receiver.stored.ranges()[0])
        return receiver, complete or same

    def program(self, session: Session, at: int, data: bytes) -> None:
        """Write a chunk. Raises FlashError."""
        self._memory.flash.program(self._memory.offset(session.area) + at, data)

    def read(self, session: Session) -> bytes:
        """Return the flash content of the session's area."""
        return self._memory.flash.read(self._memory.offset(session.area), session.size)

    def erase(self, session: Session) -> None:
        """Erase the area after a failed attempt."""
        self._memory.erase_bank(session.area)

    def keep_progress(self, session: Session) -> None:
        """Record the chunks stored in flash, so that the upload can resume after a reset."""
        upload = self._memory.record.uploads.get(session.area)
        if session.receiver is not None and upload is not None:
            ranges = session.receiver.stored.ranges()[0]
            suspended = SuspendedUpload(session.size, session.chunk_bytes, session.sha256.hex(), ranges)
            self._memory.record.uploads[session.area] = suspended
            self._memory.save()

    # --- commit -------------------------------------------------------------------------------------------------

    def commit(self, session: Session, content: bytes) -> None:
        """Commit the content to the area. Raises Rejection if the content is invalid or for another camera."""
        try:
            record = self._catalogue(content) if session.kind == "catalogue" else self._table(session.kind, content)
        except (CorruptData, BadInput) as error:
            raise Rejection("incompatible", str(error)) from error
        for name, stated in session.offered.items():
            if float(getattr(record, name)) != stated:
                raise Rejection(
                    "incompatible", f"{name}: OPEN_UPLOAD stated {stated:g}, the content has {getattr(record, name):g}"
                )
        self._memory.record.uploads.pop(session.area, None)
        self._memory.record.banks[session.area] = BankRecord(
            "committed",
            session.size,
            session.sha256.hex(),
            record.stars,
            record.pairs,
            record.epoch_jyear,
            record.format_version,
            record.profile,
        )
        self._memory.save()

    def _catalogue(self, content: bytes) -> BankRecord:
        header, catalogue = read_header(content), decode(content)
        self._check_profile(header.profile_name, "catalogue")
        version = FORMATS[header.format_name]
        if version not in self.formats("catalogue"):
            raise Rejection("incompatible", f"this unit does not read the {header.format_name} format")
        return BankRecord(
            stars=len(catalogue),
            pairs=len(catalogue.distances),
            epoch_jyear=header.epoch_jyear,
            format_version=version,
            profile=header.profile_name,
        )

    def _table(self, kind: str, content: bytes) -> BankRecord:
        if kind == "triplets":
            table = triplets.decode_triplets(content)
            version = triplets.HEADER_VERSION
            return BankRecord(stars=table.stars, pairs=len(table), format_version=version, profile=self._profile.name)
        if kind == BAD_PIXELS:
            name, pixels = decode_bad_pixels(content)
            self._check_profile(name, kind)
            check_bad_pixels(self._profile, pixels)
            return BankRecord(format_version=TABLE_FORMAT, profile=name)
        name, values = decode_table(kind, content)
        self._check_profile(name, kind)
        if kind == "calibration":
            calibrated(self._profile, values)
        else:
            check_parameters(self._profile, values)
        return BankRecord(format_version=TABLE_FORMAT, profile=name)

    def _check_profile(self, name: str, kind: str) -> None:
        if name != self._profile.name:
            raise Rejection("incompatible", f"{kind} is for {name}, this is {self._profile.name}")
