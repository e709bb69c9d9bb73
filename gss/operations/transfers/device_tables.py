"""Creates, stores and uploads the sensor's tables (calibrations, parameter sets, triplets, bad pixels), and returns its
reports of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import TransferDone
from gss.device.tables import Scalar
from gss.domain.errors import BadInput, GssError, NotFound
from gss.domain.json_object import JsonObject
from gss.domain.stars import StarTable
from gss.instruments.registry import Registry
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.line.link import LinkService
from gss.operations.transfers import table_content
from gss.operations.transfers.flash_banks import FACTORY, TABLES, BankReport, FlashBanks
from gss.operations.transfers.transfer_progress import TransferView
from gss.operations.transfers.transfers import TransferService
from gss.store import catalogues as catalogue_store
from gss.store import device_tables as store
from gss.store.blobs import BlobStore
from gss.store.engine import Database
from gss.store.models import DeviceTable, Transfer

READ_BACK = (*table_content.KINDS, "star_list", "distance_table")


@dataclass(frozen=True)
class TableReport:
    """A table bank as reported by the device. ``table_id``: stored table with the same hash, None if there is none."""

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
    """Manages the tables in the store and on board."""

    def __init__(
        self,
        link: LinkService,
        flash: FlashBanks,
        transfers: TransferService,
        database: Database,
        blobs: BlobStore,
        bus: EventBus,
        stars: StarTable,
        now: Now,
        instruments: Registry,
    ) -> None:
        self._instruments = instruments
        self._link, self._transfers, self._database, self._blobs = link, transfers, database, blobs
        self._flash, self._bus, self._stars, self._now = flash, bus, stars, now

    def defaults(self, kind: str, profile_name: str) -> dict[str, Scalar]:
        """Return the initial values of a new table. Raises BadInput or NotFound."""
        return table_content.defaults(kind, self._instruments.camera(profile_name))

    def takes(self, kind: str, profile_name: str) -> bool:
        """True if the interface of an instrument has this kind of table. Raises NotFound for an unknown instrument."""
        return kind in self._instruments.get(profile_name).roles.operations.table_kinds()

    # --- creation -----------------------------------------------------------------------------------------------

    def create(self, kind: str, name: str, profile_name: str, content: Mapping[str, Any], *, user: str) -> DeviceTable:
        """Create a table from the default values of the camera and the values in ``content``, which take precedence.
        Triplets need content["catalogue_id"]. Raises BadInput."""
        if kind == "triplets":
            data, values, profile_name = self._triplets(profile_name, content)
        else:
            data, values = table_content.table_bytes(kind, self._instruments.camera(profile_name), content)
        version = table_content.FORMATS[kind]
        return self._store_table(
            kind, name or f"{profile_name} {kind}", profile_name, version, data, dict(values), user
        )

    def _triplets(self, profile_name: str, content: Mapping[str, Any]) -> tuple[bytes, JsonObject, str]:
        catalogue_id = content.get("catalogue_id")
        if not isinstance(catalogue_id, int):
            raise BadInput("triplets need a catalogue", expected="catalogue_id", got=str(catalogue_id))
        with self._database.unit_of_work() as session:
            row = catalogue_store.get(session, catalogue_id)
        if row.profile != profile_name:
            raise BadInput("this catalogue is for another camera", expected=profile_name, got=row.profile)
        image = self._blobs.get(row.sha256)
        stars = table_content.star_list(image, self._stars, [int(hip) for hip in row.manifest["hip"]])
        changes = {k: v for k, v in content.items() if k != "catalogue_id"}
        camera = self._instruments.camera(row.profile)
        data, values = table_content.triplet_bytes(stars, camera, image, changes)
        return data, {**values, "catalogue_id": catalogue_id}, row.profile

    def _store_table(
        self, kind: str, name: str, profile_name: str, version: int, data: bytes, content: JsonObject, user: str
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
        self._bus.record("catalogue", "ok", f"{kind} table {row.name} stored by {user}", table_id=row.id)
        return row

    # --- queries ------------------------------------------------------------------------------------------------

    def newest(self, limit: int, kind: str = "") -> list[DeviceTable]:
        """Return up to ``limit`` tables, latest first."""
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

    def on_board(self) -> list[TableReport]:
        """Return the latest report of each table bank."""
        reports = self._flash.of(TABLES)
        with self._database.unit_of_work() as session:
            stored_tables = [store.by_sha256(session, r.kind, r.sha256) if r.sha256 else None for r in reports]
        return [_report(report, row) for report, row in zip(reports, stored_tables, strict=True)]

    def at_work(self) -> dict[str, str]:
        """Return the hashes of the active tables by kind, without factory tables."""
        active_reports = [r for r in self._flash.of(TABLES) if r.active and r.bank != FACTORY and r.holds_data]
        return {report.kind: report.sha256 for report in active_reports}

    def bytes_of(self, kind: str, sha256: str) -> bytes:
        """Return the bytes of the table with a hash. Raises NotFound if the ground does not have this table."""
        with self._database.unit_of_work() as session:
            stored = store.by_sha256(session, kind, sha256)
        if stored is None:
            raise NotFound(f"the ground does not have the {kind} that was active", got=sha256[:12])
        return self._blobs.get(sha256)

    def upload(self, table_id: int, bank: str) -> TransferView:
        """Upload a table to an inactive bank. It is then read back, verified and committed. Raises BadInput or
        Conflict."""
        row = self.get(table_id)
        if row.kind not in table_content.KINDS:
            raise BadInput(
                "this kind of table cannot be uploaded", expected=" | ".join(table_content.KINDS), got=row.kind
            )
        target, hello = self._flash.target(row.kind, bank)
        if row.profile != hello.profile:
            raise BadInput("this table is for another camera", expected=hello.profile, got=row.profile)
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

    def keep_read_back(self, transfer: Transfer, done: TransferDone) -> JsonObject:
        """Store a table that was read back, unless it is already stored. Return the link for the transfer's row."""
        with self._database.unit_of_work() as session:
            stored = store.by_sha256(session, done.kind, done.sha256)
        if stored is not None:
            return {"table_id": stored.id}
        hello = self._link.hello
        try:
            profile_name, version, content = table_content.read_back(done.kind, done.data)
        except GssError as error:
            profile_name, version, content = "", 0, {"problem": str(error)}
            self._bus.record(
                "catalogue", "warning", f"{transfer.subject} is not a valid table: {error}", transfer_id=transfer.id
            )
        name = profile_name or (hello.profile if hello else "unknown")
        row = self._store_table(
            done.kind, transfer.subject, name, version, done.data, dict(content), "read back from the device"
        )
        return {"table_id": row.id}


def _report(report: BankReport, stored: DeviceTable | None) -> TableReport:
    values = report.values
    return TableReport(
        report.kind,
        report.bank,
        report.state,
        report.active,
        int(values["size_bytes"]),
        int(values["capacity_bytes"]),
        int(values["format_version"]),
        str(values["profile"]),
        int(values["confirm_left_s"]),
        report.sha256,
        stored.id if stored else None,
    )
