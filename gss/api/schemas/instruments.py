"""Instrument packages: list, details, check result and differences."""

from __future__ import annotations

from typing import Literal

from gss.api.schemas.base import Out
from gss.instruments.package_files import CatalogueFile, LinkFile, Mounting, SimulatorFile


class UseOut(Out):
    """Number of stored rows of an instrument. ``version`` null: version not recorded, or all versions together."""

    version: str | None
    frames: int
    contacts: int
    catalogues: int


class InstrumentOut(Out):
    """Installed instrument. ``version``: SHA-256 of the package's content; ``release``: the author's version.
    ``configured``: true if the line is configured for this instrument; ``in_use``: version that the server loaded at
    its start; ``connected``: true if a device of this type responds now."""

    name: str
    title: str
    maker: str
    release: str
    version: str
    origin: Literal["shipped", "own"]
    configured: bool
    connected: bool
    in_use: str | None
    use: UseOut


class BrokenPackageOut(Out):
    """Folder in the data folder that is not a valid package."""

    name: str
    reason: str


class InstrumentsOut(Out):
    """All instruments. ``unit``: name of the instrument for which the server's line is configured."""

    unit: str
    instruments: list[InstrumentOut]
    broken: list[BrokenPackageOut]


class CameraNumberOut(Out):
    """Number in the camera file with its unit, standard deviation if known, and origin: either its source, or the
    reason for its choice."""

    part: str
    name: str
    values: list[float]
    unit: str
    sigma: float | None
    source: str | None
    chosen: str | None


class ProcedureOut(Out):
    """Operator procedure of a package."""

    file: str
    title: str


class DictionarySummaryOut(Out):
    """Dictionary of an instrument. ``shared``: name of the shared dictionary; null if the package contains a
    dictionary."""

    shared: str | None
    hash: str
    commands: int
    packets: int
    events: int


class InstrumentDetailOut(InstrumentOut):
    """Complete content of a package. ``versions``: stored versions, current version first; ``uses``: use of each
    version; ``catalogue``: null if no catalogue can be loaded into the sensor."""

    versions: list[str]
    uses: list[UseOut]
    references: list[str]
    notes: str
    tried_on_hardware: bool | None
    driver: str
    chain: str
    mounting: Mounting
    numbers: list[CameraNumberOut]
    field_of_view_deg: tuple[float, float]
    link: LinkFile
    catalogue: CatalogueFile | None
    simulator: SimulatorFile | None
    dictionary: DictionarySummaryOut
    procedures: list[ProcedureOut]
    files: list[str]


class FileDifferenceOut(Out):
    """Differing lines of one file in unified format."""

    file: str
    state: Literal["added", "removed", "changed"]
    lines: list[str]


class PackageCheckOut(Out):
    """Result of checking a package. ``problems``: one text per mistake with file, line, field and reason; ``replaces``:
    installed version with the same name."""

    valid: bool
    name: str
    title: str
    version: str
    problems: list[str]
    replaces: str | None
    differences: list[FileDifferenceOut]
