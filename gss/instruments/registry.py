"""Registry of the instruments of this installation by name: shipped instruments and packages of the user."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import threading
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput, Conflict, GssError, NotFound
from gss.instruments.package import Instrument, load_instrument
from gss.instruments.package_source import (
    Files,
    is_package_file,
    read_folder,
    read_zip,
    write_folder,
    write_zip,
)

SHIPPED = Path(__file__).parent / "shipped"
HISTORY = ".versions"
PACKAGE_NAME = re.compile(r"[a-z][a-z0-9_-]{1,15}")
VERSION_FILE = re.compile(rf"{PACKAGE_NAME.pattern}-[0-9a-f]+\.zip")
Signature = tuple[tuple[str, int, int], ...]


@dataclass(frozen=True)
class BrokenPackage:
    """A folder of the user's instruments that is not a valid package."""

    name: str
    reason: str


class Registry:
    """Instruments by name. ``own_folder``: folder with one folder per user package; None without user packages.

    A package is read at its first use. A user package is read again if its files have changed. Thread-safe.
    """

    def __init__(self, own_folder: Path | None = None) -> None:
        self._folder = own_folder
        self._lock = threading.RLock()
        self._shipped: dict[str, Instrument] = {}
        self._read: dict[str, tuple[Signature, Instrument | GssError]] = {}

    def names(self) -> tuple[str, ...]:
        """Return the names of all packages, including broken packages; shipped packages come first."""
        shipped = _folders(SHIPPED)
        return (*shipped, *(name for name in self._own_names() if name not in shipped))

    def get(self, name: str) -> Instrument:
        """Return an instrument. Raises NotFound, or BadInput if its package is invalid."""
        with self._lock:
            if name in _folders(SHIPPED):
                if name not in self._shipped:
                    self._shipped[name] = load_instrument(read_folder(SHIPPED / name), shipped=True)
                return self._shipped[name]
            if name in self._own_names():
                return self._own_instrument(name)
        raise NotFound("unknown instrument", expected=" | ".join(self.names()), got=name)

    def camera(self, name: str) -> CameraProfile:
        """Return the documented camera of an instrument. Raises NotFound."""
        return self.get(name).profile

    def version_of(self, name: str | None) -> str | None:
        """Return the version of an instrument; None if there is no name or no valid package."""
        return self.get(name).version if name and self.has(name) else None

    def find_camera(self, name: str | None) -> CameraProfile | None:
        """Return the documented camera of an instrument; None if there is no name or no valid package."""
        return self.camera(name) if name and self.has(name) else None

    def bank_bytes(self, name: str) -> int | None:
        """Return the size of an instrument's banks; None if its package is unknown or describes no catalogue."""
        catalogue = self.get(name).catalogue if self.has(name) else None
        return None if catalogue is None else catalogue.bank_bytes

    def has(self, name: str) -> bool:
        """True if there is a valid package with this name."""
        try:
            self.get(name)
        except GssError:
            return False
        return True

    def all(self) -> tuple[Instrument, ...]:
        """Return all valid instruments."""
        return tuple(self.get(name) for name in self.names() if self.has(name))

    def cameras(self) -> dict[str, CameraProfile]:
        """Return the cameras of all valid instruments by name."""
        return {i.name: i.profile for i in self.all()}

    def broken(self) -> tuple[BrokenPackage, ...]:
        """Return the invalid user packages, with the reasons."""
        problems = []
        for name in self.names():
            try:
                self.get(name)
            except GssError as error:
                problems.append(BrokenPackage(name, str(error)))
        return tuple(problems)

    def folder(self, name: str) -> Path:
        """Return the folder of a package, for use by another process. Raises NotFound."""
        instrument = self.get(name)
        return SHIPPED / name if instrument.shipped else self._own_folder() / name

    def add(self, files: Files, *, replaces: bool = True) -> Instrument:
        """Install a user package. It replaces a package of the same name; the replaced version is kept for comparison.
        Raises BadInput. Raises Conflict for the name of a shipped instrument, or for any existing name if ``replaces``
        is False."""
        instrument = load_instrument(files)
        name, own_folder = instrument.name, self._own_folder()
        self.check_name(name)
        with self._lock:
            if not replaces and name in self._own_names():
                raise Conflict("an instrument of this name exists", got=name, hint="choose another name")
            history = own_folder / HISTORY
            history.mkdir(parents=True, exist_ok=True)
            archive = history / f"{name}-{instrument.version}.zip"
            part = archive.with_suffix(".part")
            part.write_bytes(write_zip(name, files))
            part.replace(archive)
            new = Path(tempfile.mkdtemp(prefix=".new-", dir=own_folder))
            try:
                write_folder(new, files)
                _replace(new, own_folder / name)
            finally:
                shutil.rmtree(new, ignore_errors=True)
            self._read.pop(name, None)
        return self.get(name)

    def check_name(self, name: str) -> None:
        """Raise Conflict if a user package must not have this name."""
        if name in _folders(SHIPPED):
            raise Conflict("a shipped instrument cannot be replaced", got=name, hint="change the id of your package")

    def find(self, name: str, version: str = "") -> Instrument:
        """Return a version of an instrument, by default the current version. Raises NotFound."""
        return self.version(name, version) if version else self.get(name)

    def version(self, name: str, version: str) -> Instrument:
        """Return the current version or an earlier installed version of an instrument. Raises NotFound."""
        current = self.get(name)
        if current.version.startswith(version):
            return current
        for at in self.versions(name):
            if at.startswith(version):
                return load_instrument(read_zip((self._own_folder() / HISTORY / f"{name}-{at}.zip").read_bytes()))
        raise NotFound("unknown version of an instrument", expected=", ".join(self.versions(name)), got=version)

    def versions(self, name: str) -> tuple[str, ...]:
        """Return the versions of an instrument: the current version, then the other installed versions, latest
        first."""
        current = self.get(name)
        if current.shipped or self._folder is None:
            return (current.version,)
        archives = sorted(
            (self._folder / HISTORY).glob(f"{name}-*.zip"), key=lambda p: p.stat().st_mtime_ns, reverse=True
        )
        added = [p.stem.removeprefix(f"{name}-") for p in archives]
        return (current.version, *(v for v in added if v != current.version and len(v) == len(current.version)))

    def _own_names(self) -> tuple[str, ...]:
        return _folders(self._folder) if self._folder is not None else ()

    def _own_folder(self) -> Path:
        if self._folder is None:
            raise NotFound("no data folder", expected="a data folder with instruments", hint="use the option --data")
        return self._folder

    def _own_instrument(self, name: str) -> Instrument:
        folder = self._own_folder() / name
        try:
            signature = _signature(folder)
            cached = self._read.get(name)
            if cached is None or cached[0] != signature:
                cached = self._read[name] = signature, _read_own(name, folder)
        except OSError as error:  # not kept, because a change of the permissions does not change the signature
            raise BadInput(
                "the package cannot be read", got=str(error), hint="check the permissions of its files"
            ) from None
        if isinstance(cached[1], GssError):
            raise cached[1]
        return cached[1]


def _read_own(name: str, folder: Path) -> Instrument | GssError:
    try:
        instrument = load_instrument(read_folder(folder))
    except GssError as error:
        return error
    if instrument.name != name:
        return BadInput("the folder must have the name of the instrument", expected=instrument.name, got=name)
    return instrument


def _folders(folder: Path) -> tuple[str, ...]:
    """Return the names of the package folders in a folder, sorted."""
    try:
        with os.scandir(folder) as entries:
            return tuple(sorted(e.name for e in entries if e.is_dir() and e.name[0] not in "._"))
    except FileNotFoundError:
        return ()


def _signature(folder: Path) -> Signature:
    """Return names, times and sizes of the files in a folder. The result changes if a file changes."""
    stats = [(p.relative_to(folder).as_posix(), p.stat()) for p in sorted(folder.rglob("*")) if p.is_file()]
    return tuple((name, s.st_mtime_ns, s.st_size) for name, s in stats)


def is_installed_file(name: str) -> bool:
    """True if a folder of user packages may contain a file with this relative path."""
    package, _, file = name.partition("/")
    if package == HISTORY:
        return VERSION_FILE.fullmatch(file) is not None
    return PACKAGE_NAME.fullmatch(package) is not None and is_package_file(file)


def installed_files(folder: Path) -> dict[str, Path]:
    """Return the files of the user packages in a folder, with their earlier versions, by relative path."""
    paths = {p.relative_to(folder).as_posix(): p for p in sorted(folder.rglob("*")) if p.is_file()}
    return {name: path for name, path in paths.items() if is_installed_file(name)}


def _replace(new: Path, folder: Path) -> None:
    """Move a complete new folder to ``folder``, which may exist and is then replaced."""
    if folder.exists():
        old = Path(tempfile.mkdtemp(prefix=".old-", dir=folder.parent))
        folder.rename(old / "package")
        new.rename(folder)
        shutil.rmtree(old)
    else:
        new.rename(folder)


@lru_cache(maxsize=1)
def shipped_registry() -> Registry:
    """Return the registry of the shipped instruments alone, for programs without a data folder."""
    return Registry()


def shipped_version(name: str) -> str | None:
    """Return the version of a shipped instrument; None if there is no such instrument."""
    return shipped_registry().version_of(name)


def shipped_camera(name: str) -> CameraProfile:
    """Return the camera of a shipped instrument. Raises NotFound."""
    return shipped_registry().camera(name)
