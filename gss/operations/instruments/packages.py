"""Instrument packages: list of installed packages and their use, and installation of new packages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from gss.domain.errors import GssError
from gss.instruments.compare import FileDifference, compare
from gss.instruments.package import Instrument
from gss.instruments.package_source import Files, write_zip
from gss.instruments.registry import BrokenPackage, Registry
from gss.operations.events import EventBus
from gss.operations.instruments.package_check import CheckedPackage, check_zip
from gss.operations.line.link import LinkService
from gss.operations.parsing.parse_processes import ParseProcesses
from gss.store import instruments as store
from gss.store.engine import Database
from gss.store.instruments import UseCount


@dataclass(frozen=True)
class Installed:
    """An instrument and its use. ``configured``: True if the server's line uses this instrument. ``connected``: True if
    the connected device reports this profile. ``in_use``: version that the server loaded at its start, None if the
    server's line does not use this instrument."""

    instrument: Instrument
    uses: Sequence[UseCount]
    configured: bool
    connected: bool
    in_use: str | None

    @property
    def total(self) -> UseCount:
        """Sum of the use counts of all versions."""
        return _sum(self.instrument.name, None, self.uses)


@dataclass(frozen=True)
class PackageReport:
    """Result of checking a package. ``problems``: file, line, field and reason of each mistake; empty if the package can be
    installed. ``replaces``: installed version of the same name. ``differences``: differences from that version."""

    checked: CheckedPackage | None
    problems: tuple[str, ...]
    replaces: str | None
    differences: tuple[FileDifference, ...]


class InstrumentService:
    """Lists, checks, installs, exports and compares packages. ``unit``: instrument of the unit on the line."""

    def __init__(
        self,
        instruments: Registry,
        unit: Instrument,
        database: Database,
        parsing: ParseProcesses,
        link: LinkService,
        bus: EventBus,
    ) -> None:
        self._instruments, self.unit, self._database = instruments, unit, database
        self._parsing, self._link, self._bus = parsing, link, bus

    def all(self) -> list[Installed]:
        """Return all valid instruments. Instruments shipped with GSS come first."""
        counts = self._counts()
        return [self._installed(i, counts) for i in self._instruments.all()]

    def broken(self) -> tuple[BrokenPackage, ...]:
        """Return the installed packages that cannot be loaded, with the reason."""
        return self._instruments.broken()

    def get(self, name: str, version: str = "") -> Installed:
        """Return an instrument in the given version, by default in its current version. Raises NotFound."""
        instrument = self._instruments.find(name, version)
        return self._installed(instrument, self._counts())

    def versions(self, name: str) -> tuple[str, ...]:
        """Return the stored versions of an instrument, the current version first. Raises NotFound."""
        return self._instruments.versions(name)

    def check(self, data: bytes, filename: str) -> PackageReport:
        """Check a zipped package in a child process and compare it with the installed version. Nothing is changed. Mistakes,
        exceeded limits and a full queue are reported as ``problems``."""
        try:
            checked = self._checked(data, filename)
            self._instruments.check_name(checked.name)
        except GssError as error:
            return PackageReport(None, tuple(str(error).splitlines()), None, ())
        old = self._instruments.get(checked.name) if self._instruments.has(checked.name) else None
        differences = compare(old.files, checked.files) if old is not None else ()
        return PackageReport(checked, (), old.version if old is not None else None, differences)

    def add(self, data: bytes, filename: str, *, user: str) -> Installed:
        """Check a zipped package in a child process and install it. If an exception is raised, nothing was changed. Raises
        BadInput with the mistakes, Conflict for the name of an instrument shipped with GSS, TooCostly, and Busy."""
        checked = self._checked(data, filename)
        instrument = self._instruments.add(checked.files)
        text = f"Instrument {instrument.name} version {instrument.version[:12]} installed by {user}"
        self._bus.record("instrument", "watch", text, instrument=instrument.name, version=instrument.version)
        return self._installed(instrument, self._counts())

    def export(self, name: str, version: str = "") -> bytes:
        """Return a package as a zip archive. Raises NotFound."""
        return write_zip(name, self._instruments.find(name, version).files)

    def compare(self, old: str, new: str) -> tuple[FileDifference, ...]:
        """Return the differences between two packages. ``old``, ``new``: NAME or NAME@VERSION. Raises NotFound."""
        return compare(self._files(old), self._files(new), old, new)

    def _files(self, reference: str) -> Files:
        name, _, version = reference.partition("@")
        return self._instruments.find(name, version).files

    def _checked(self, data: bytes, filename: str) -> CheckedPackage:
        label = filename or "the package"
        return self._parsing.parse(check_zip, data, classes=(CheckedPackage,), subject=label)

    def _counts(self) -> list[UseCount]:
        with self._database.unit_of_work() as session:
            return store.uses(session)

    def _installed(self, instrument: Instrument, counts: Sequence[UseCount]) -> Installed:
        name, hello = instrument.name, self._link.hello
        configured = name == self.unit.name
        return Installed(
            instrument,
            [count for count in counts if count.name == name],
            configured,
            hello is not None and hello.profile == name,
            self.unit.version if configured else None,
        )


def _sum(name: str, version: str | None, uses: Sequence[UseCount]) -> UseCount:
    total = UseCount(name, version, 0, 0, 0)
    for use in uses:
        total = replace(
            total,
            frames=total.frames + use.frames,
            contacts=total.contacts + use.contacts,
            catalogues=total.catalogues + use.catalogues,
        )
    return total
