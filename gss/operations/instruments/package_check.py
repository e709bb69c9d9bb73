"""Check of an uploaded package. It runs in a child process of :mod:`gss.operations.parsing`."""

from __future__ import annotations

from dataclasses import dataclass

from gss.instruments.package_source import read_zip


@dataclass(frozen=True)
class CheckedPackage:
    """A valid package with its decompressed files."""

    name: str
    title: str
    version: str
    files: dict[str, bytes]


def check_zip(data: bytes) -> CheckedPackage:
    """Check a zipped package completely and return its files. Raises BadInput with file, line, field and reason of each
    mistake."""
    files = read_zip(data)
    # A file that is not an archive of a package is rejected without this import, which takes 2 s.
    from gss.instruments.package import load_instrument

    instrument = load_instrument(files)
    return CheckedPackage(instrument.name, instrument.about.title, instrument.version, files)
