"""Star lists uploaded by users. They are parsed, validated, stored unchanged, and used as a source of stars."""

from __future__ import annotations

import threading
from dataclasses import asdict

from gss.catalogue_tools.sources.sources import StarSource, load_source, of_list
from gss.catalogue_tools.sources.star_list_mapping import KINDS, ListMapping
from gss.catalogue_tools.sources.star_list_values import DroppedRow
from gss.catalogue_tools.sources.star_lists import ImportedList, for_known_cameras, read_with_mapping, require_camera
from gss.domain.errors import BadInput
from gss.domain.stars import StarTable
from gss.instruments.registry import Registry
from gss.operations.clock import Now
from gss.operations.parsing.parse_processes import ParseProcesses
from gss.store import star_lists as store
from gss.store.blobs import BlobStore
from gss.store.engine import Database
from gss.store.models import StarList

MAX_BYTES = 64 << 20
SUFFIXES = {
    "csv": "csv",
    "txt": "csv",
    "ecsv": "ecsv",
    "fits": "fits",
    "fit": "fits",
    "vot": "votable",
    "xml": "votable",
}
KEPT_LISTS = 4
SHOWN_ROWS = 20


class StarListService:
    """Stores star lists, and returns sources of stars by name."""

    def __init__(
        self, database: Database, blobs: BlobStore, now: Now, parsing: ParseProcesses, instruments: Registry
    ) -> None:
        self._instruments = instruments
        self._database, self._blobs, self._now, self._parsing = database, blobs, now, parsing
        self._read: dict[int, StarSource] = {}
        self._lock = threading.Lock()

    def add(
        self, data: bytes, filename: str, mapping: ListMapping, *, user: str, profile: str = "", name: str = ""
    ) -> StarList:
        """Parse and store a file. The report of the returned row lists the columns read and the rows dropped. ``profile``:
        camera that the list is intended for, if the file does not state it. Raises BadInput if the file names another
        camera."""
        if len(data) > MAX_BYTES:
            raise BadInput(
                "the star list is too large", expected=f"at most {MAX_BYTES} bytes", got=f"{len(data)} bytes"
            )
        if profile:
            self._instruments.get(profile)
        kind = kind_of(filename)
        read = for_known_cameras(parse_star_list(self._parsing, data, kind, mapping), self._instruments.names())
        if profile:
            require_camera(read.camera, profile)
        row = StarList(
            name="".join(
                c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in name or filename or "star list"
            )[:80],
            created=self._now(),
            author=user,
            format=kind,
            epoch_jyear=read.epoch_jyear,
            frame=read.frame,
            profile=profile or read.camera,
            stars=len(read.stars),
            dropped=read.dropped_count,
            size=len(data),
            sha256=self._blobs.put(data),
            mapping=asdict(mapping),
            report=report_of(read),
        )
        with self._database.unit_of_work() as session:
            row = store.add(session, row)
        with self._lock:
            self._keep(row.id, of_list(read.stars, row.name))
        return row

    def newest(self, limit: int) -> list[StarList]:
        """Return the latest lists, newest first."""
        with self._database.unit_of_work() as session:
            return store.newest(session, limit)

    def get(self, list_id: int) -> StarList:
        """Return the list with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.get(session, list_id)

    def source(self, name: str, list_id: int | None, v_max: float | None, profile: str) -> StarSource:
        """Return the source of stars with this name; for the name "list", the star list with this id. Raises BadInput if the
        list is intended for another camera."""
        if name != "list":
            return load_source(name, v_max)
        if list_id is None:
            raise BadInput("no star list was selected", expected="the id of a list", hint="upload a star list first")
        row = self.get(list_id)
        require_camera(row.profile, profile)
        with self._lock:
            cached = self._read.get(list_id)
        if cached is None:
            data, mapping = self._blobs.get(row.sha256), ListMapping(**row.mapping)
            cached = of_list(parse_star_list(self._parsing, data, row.format, mapping).stars, row.name)
            with self._lock:
                self._keep(list_id, cached)
        return cached

    def _keep(self, list_id: int, source: StarSource) -> None:
        self._read.pop(list_id, None)
        while len(self._read) >= KEPT_LISTS:
            del self._read[next(iter(self._read))]
        self._read[list_id] = source


def parse_star_list(parsing: ParseProcesses, data: bytes, kind: str, mapping: ListMapping) -> ImportedList:
    """Run :func:`read_with_mapping` in a child process. It can also raise TooCostly and Busy."""
    classes = (ImportedList, StarTable, DroppedRow)
    return parsing.parse(read_with_mapping, data, kind, asdict(mapping), classes=classes, subject="the star list")


def kind_of(filename: str) -> str:
    """Return the kind of a file from the suffix of its name. Raises BadInput if the suffix is unknown."""
    suffix = filename.rpartition(".")[2].lower()
    if suffix not in SUFFIXES:
        raise BadInput(
            "unknown kind of star list",
            expected=" | ".join(KINDS),
            got=filename or "the file has no name",
            hint="use a file name that ends in " + ", ".join(SUFFIXES),
        )
    return SUFFIXES[suffix]


def report_of(read: ImportedList) -> dict[str, object]:
    """Return the columns, units and notes of a list and the dropped rows, as plain values."""
    return {
        "columns": dict(read.columns),
        "units": dict(read.units),
        "notes": list(read.notes),
        "dropped": [
            {"row": d.row, "column": d.column, "reason": d.reason, "value": str(d.value)}
            for d in read.dropped[:SHOWN_ROWS]
        ],
    }
