"""Calibrations, parameter sets and triplet tables: created, stored, uploaded to the sensor, and as reported by it."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gss.device.dictionary import Dictionary
from gss.device.session import Compatibility
from gss.device.session_events import TransferDone
from gss.domain.errors import BadInput, Conflict, GssError, NotFound
from gss.domain.stars import StarTable
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.line.link import LinkService
from gss.operations.transfers import table_content
from gss.operations.transfers.transfer_rows import TransferView
from gss.operations.transfers.transfers import TransferService
from gss.store import catalogues as catalogue_store
from gss.store import device_tables as store
from gss.store.blobs import BlobStore
from gss.store.engine import Database
from gss.store.models import DeviceTable, Transfer

HOLDS_DATA = ("loaded", "committed")
FACTORY = "factory"
READ_BACK = ("triplets", "calibration", "parameters", "star_list", "distance_table")


@dataclass(frozen=True)
class TableReport:
    """A table bank as the device reports it. ``table_id``: the stored table of the same hash, if any."""

    table: str
    bank: str
    state: str
    active: bool
    size_bytes: int
    capacity_bytes: int
    format_version: int
    profile: str
    confirm_left_s: int
    sha256: str
    table_id: int | None


class DeviceTableService:
    """Manages tables in the store and tables on board."""

    def __init__(
        self,
        link: LinkService,
        transfers: TransferService,
        database: Database,
        blobs: BlobStore,
        bus: EventBus,
        stars: StarTable,
        now: Now,
    ) -> None:
        self._link, self._transfers, self._database, self._blobs = link, transfers, database, blobs
        self._bus, self._stars, self._now = bus, stars, now
        self._reports: dict[tuple[str, str], Mapping[str, Any]] = {}
        self._lock = threading.Lock()

    # --- creation -----------------------------------------------------------------------------------------------

    def create(self, kind: str, name: str, profile_name: str, content: Mapping[str, Any], *, user: str) -> DeviceTable:
        """Create a table: the camera's default values, overridden by ``content``. Triplets need content["catalogue_id"].
        Raises BadInput."""
        if kind == "triplets":
            data, values, profile_name = self._triplets(profile_name, content)
        else:
            data, values = table_content.table_bytes(kind, profile_name, content)
        version = table_content.FORMATS[kind]
        return self._keep(kind, name or f"{profile_name} {kind}", profile_name, version, data, dict(values), user)

    def _triplets(self, profile_name: str, content: Mapping[str, Any]) -> tuple[bytes, dict[str, Any], str]:
        catalogue_id = content.get("catalogue_id")
        if not isinstance(catalogue_id, int):
            raise BadInput("triplets of which catalogue?", expected="catalogue_id", got=str(catalogue_id))
        with self._database.unit_of_work() as session:
            row = catalogue_store.get(session, catalogue_id)
        if row.profile != profile_name:
            raise BadInput("this catalogue is for another camera", expected=profile_name, got=row.profile)
        image = self._blobs.get(row.sha256)
        stars = table_content.star_list(image, self._stars, [int(hip) for hip in row.manifest["hip"]])
        changes = {k: v for k, v in content.items() if k != "catalogue_id"}
        data, values = table_content.triplet_bytes(stars, image, changes)
        return data, {**values, "catalogue_id": catalogue_id}, row.profile

    def _keep(
        self, kind: str, name: str, profile_name: str, version: int, data: bytes, content: dict[str, Any], user: str
    ) -> DeviceTable:
        row = DeviceTable(
            kind=kind,
            name=name[:80],
            profile=profile_name,
            format_version=version,
            size=len(data),
            sha256=self._blobs.put(data),
            created=self._now(),
            author=user,
            content=content,
        )
        with self._database.unit_of_work() as session:
            store.add(session, row)
        self._bus.record("catalogue", "ok", f"{kind} table {row.name} kept, by {user}", table_id=row.id)
        return row

    # --- queries ------------------------------------------------------------------------------------------------

    def newest(self, limit: int, kind: str = "") -> list[DeviceTable]:
        """Return the newest tables first."""
        with self._database.unit_of_work() as session:
            return store.newest(session, limit, kind)

    def get(self, table_id: int) -> DeviceTable:
        """Return the table with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.get(session, table_id)

    def data(self, table_id: int) -> bytes:
        """Return the bytes of a table in the sensor's format."""
        return self._blobs.get(self.get(table_id).sha256)

    # --- on board -----------------------------------------------------------------------------------------------

    def forget(self) -> None:
        """Discard all reports, because the device restarted."""
        with self._lock:
            self._reports.clear()

    def told(self, info: Mapping[str, Any]) -> bool:
        """Store a report of a table bank. Return True if the device currently uses that bank."""
        with self._lock:
            self._reports[str(info["table"]), str(info["bank"])] = info
        self._bus.publish("tables", self.on_board())
        return bool(info["active"]) and str(info["state"]) in HOLDS_DATA

    def on_board(self) -> list[TableReport]:
        """Return every table bank that the device reported."""
        with self._lock:
            reports = list(self._reports.values())
        with self._database.unit_of_work() as session:
            known = {_hex(i["sha256"]): store.by_sha256(session, str(i["table"]), _hex(i["sha256"])) for i in reports}
        return [_report(info, known[_hex(info["sha256"])]) for info in reports]

    def at_work(self) -> dict[str, str]:
        """Return the hash of each non-factory table that the device currently uses, by kind."""
        with self._lock:
            reports = list(self._reports.values())
        used = [i for i in reports if i["active"] and str(i["bank"]) != FACTORY and str(i["state"]) in HOLDS_DATA]
        return {str(info["table"]): _hex(info["sha256"]) for info in used}

    def bytes_of(self, kind: str, sha256: str) -> bytes:
        """Return the bytes of a table by its hash. Raises NotFound if the ground does not have it."""
        with self._database.unit_of_work() as session:
            known = store.by_sha256(session, kind, sha256)
        if known is None:
            raise NotFound(f"the ground does not know the {kind} that was active", got=sha256[:12])
        return self._blobs.get(sha256)

    def upload(self, table_id: int, bank: str) -> TransferView:
        """Upload a table to an inactive bank; read-back verification and commit follow automatically. Raises BadInput or
        Conflict."""
        row, hello = self.get(table_id), self._link.hello
        if row.kind not in table_content.KINDS:
            raise BadInput("this cannot be sent", expected=" | ".join(table_content.KINDS), got=row.kind)
        if hello is None:
            raise Conflict("no device has answered", got=self._link.reason or "silence", hint="open the line first")
        if row.profile != hello.profile:
            raise BadInput("this table is for another camera", expected=hello.profile, got=row.profile)
        target = table_bank_number(self._link.dictionary, bank)
        if any((r.table, r.bank, r.active) == (row.kind, bank, True) for r in self.on_board()):
            raise Conflict(f"{row.kind} bank {bank} is active", expected="an inactive bank", got=bank)
        content, counts = row.content, ("stars", "references")
        stars, references = (int(content.get(name, 0)) if row.kind == "triplets" else 0 for name in counts)
        compatibility = Compatibility(
            device_model=hello.device_model,
            profile=row.profile,
            dictionary_hash=bytes.fromhex(hello.dictionary_hash),
            format_version=row.format_version,
            stars=stars,
            pairs=references,
        )
        subject = f"{row.name} to {row.kind} bank {bank}"
        data = self._blobs.get(row.sha256)
        return self._transfers.upload(
            row.kind, target, data, compatibility, name=bank, subject=subject, table_id=row.id
        )

    def keep_read_back(self, transfer: Transfer, done: TransferDone) -> dict[str, Any]:
        """Store a table that was read back, unless it is already stored. Returns the link for the transfer's row."""
        with self._database.unit_of_work() as session:
            known = store.by_sha256(session, done.kind, done.sha256)
        if known is not None:
            return {"table_id": known.id}
        hello = self._link.hello
        try:
            profile_name, version, content = table_content.read_back(done.kind, done.data)
        except GssError as error:
            profile_name, version, content = "", 0, {"problem": str(error)}
            self._bus.record(
                "catalogue", "warning", f"{transfer.subject} is no table: {error}", transfer_id=transfer.id
            )
        name = profile_name or (hello.profile if hello else "unknown")
        row = self._keep(
            done.kind, transfer.subject, name, version, done.data, dict(content), "read back from the device"
        )
        return {"table_id": row.id}


def table_bank_number(dictionary: Dictionary, bank: str) -> int:
    """Return the number of a table bank in the protocol. Raises BadInput with the list of banks."""
    return dictionary.command("VERIFY_TABLE").argument("bank").choice(bank).value


def _report(info: Mapping[str, Any], known: DeviceTable | None) -> TableReport:
    holds = str(info["state"]) in HOLDS_DATA
    return TableReport(
        str(info["table"]),
        str(info["bank"]),
        str(info["state"]),
        bool(info["active"]),
        int(info["size_bytes"]),
        int(info["capacity_bytes"]),
        int(info["format_version"]),
        str(info["profile"]),
        int(info["confirm_left_s"]),
        _hex(info["sha256"]) if holds else "",
        known.id if known and holds else None,
    )


def _hex(value: Any) -> str:
    return value.hex() if isinstance(value, bytes) else str(value)
