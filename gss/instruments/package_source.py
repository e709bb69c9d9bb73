"""Read and write the files of a package, as a folder or a zip archive, with limits on number, size and names."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from gss.domain.errors import BadInput, NotFound

PACKAGE_FILES = (
    "instrument.yaml",
    "camera.yaml",
    "dictionary.yaml",
    "dictionary.xml",
    "operations.yaml",
    "link.yaml",
    "catalogue.yaml",
    "simulator.yaml",
)
PROCEDURE = re.compile(r"procedures/[A-Za-z0-9][A-Za-z0-9_.-]{0,80}\.md")
MAX_FILES = 80
MAX_FILE_BYTES = 1 << 20
MAX_BYTES = 4 << 20
MAX_ZIP_BYTES = MAX_BYTES
DATE = (1980, 1, 1, 0, 0, 0)
Files = Mapping[str, bytes]


def is_package_file(name: str) -> bool:
    """True if a package may contain a file with this name."""
    return name in PACKAGE_FILES or PROCEDURE.fullmatch(name) is not None


def read_folder(folder: Path) -> dict[str, bytes]:
    """Return the files of a package folder by name, without hidden files. Raises NotFound, BadInput."""
    if not folder.is_dir():
        raise NotFound("no such package folder", expected="a folder with instrument.yaml", got=str(folder))
    names = []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if any(part.startswith(".") for part in name.split("/")) or (path.is_dir() and not path.is_symlink()):
            continue
        if path.is_symlink():
            raise BadInput(f"{name} is a symbolic link", expected="the file itself", got=str(path))
        names.append(name)
    _check_names(names)
    files: dict[str, bytes] = {}
    for name in names:
        with (folder / name).open("rb") as file:
            files[name] = file.read(MAX_FILE_BYTES + 1)
        _check_sizes(files, name)
    return files


def read_zip(data: bytes) -> dict[str, bytes]:
    """Return the files of a zipped package by name; one enclosing folder is removed. Raises BadInput.

    Sizes are checked while the archive is read, so an archive that expands to gigabytes is rejected.
    """
    if len(data) > MAX_ZIP_BYTES:
        raise BadInput("the archive is too large", expected=f"at most {MAX_ZIP_BYTES} bytes", got=str(len(data)))
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = [e for e in archive.infolist() if not e.is_dir()]
            if len(entries) > MAX_FILES:
                raise BadInput("the archive has too many files", expected=f"at most {MAX_FILES}", got=str(len(entries)))
            names = [e.filename for e in entries]
            prefix = _enclosing(names)
            _check_names([name[len(prefix) :] for name in names])
            files: dict[str, bytes] = {}
            for entry in entries:
                name = entry.filename[len(prefix) :]
                if entry.flag_bits & 1:
                    raise BadInput(f"{name} is encrypted", expected="an archive without password")
                with archive.open(entry) as file:
                    files[name] = file.read(MAX_FILE_BYTES + 1)
                _check_sizes(files, name)
            return files
    except (zipfile.BadZipFile, zipfile.LargeZipFile, NotImplementedError, EOFError, OSError, ValueError) as error:
        raise BadInput("the archive cannot be read", expected="a zip file", got=str(error)[:200]) from None
    except Exception as error:
        # zlib.error, lzma.LZMAError and similar errors have no common base class.
        if isinstance(error, BadInput):
            raise
        raise BadInput("the archive is damaged", expected="a zip file", got=str(error)[:200]) from None


def read_package_files(path: Path) -> dict[str, bytes]:
    """Return the files of a package folder or .zip file. Raises NotFound, BadInput."""
    if path.is_dir():
        return read_folder(path)
    if not path.is_file():
        raise NotFound("no such package", expected="a folder or a .zip file", got=str(path))
    with path.open("rb") as file:
        return read_zip(file.read(MAX_ZIP_BYTES + 1))


def write_zip(name: str, files: Files) -> bytes:
    """Return a zip archive that contains the files in a folder ``name``. Equal files give equal bytes."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for file, data in sorted(files.items()):
            archive.writestr(zipfile.ZipInfo(f"{name}/{file}", DATE), data, zipfile.ZIP_DEFLATED)
    return out.getvalue()


def write_folder(folder: Path, files: Files) -> None:
    """Write the files of a package into a new folder."""
    for name, data in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


def _enclosing(names: Iterable[str]) -> str:
    """Return "folder/" if all names are in one folder and none is a package file at the top level; otherwise ""."""
    names = list(names)
    tops = {name.split("/")[0] for name in names}
    if len(tops) != 1 or any("/" not in name for name in names) or tops <= {"..", ".", ""}:
        return ""
    top = tops.pop()
    return "" if top == "procedures" else f"{top}/"


def _check_names(names: Iterable[str]) -> None:
    """Raise BadInput for names that a package cannot contain, including absolute names and names with ``..``."""
    names = list(names)
    if len(names) > MAX_FILES:
        raise BadInput("the package has too many files", expected=f"at most {MAX_FILES}", got=str(len(names)))
    for name in names:
        if not is_package_file(name):
            raise BadInput(
                "a package has no such file", expected=f"{', '.join(PACKAGE_FILES)}, procedures/*.md", got=name[:200]
            )
    if len(set(names)) < len(names):
        raise BadInput("a file appears twice in the package", got=next(n for n in names if names.count(n) > 1))


def _check_sizes(files: Files, name: str) -> None:
    if len(files[name]) > MAX_FILE_BYTES:
        raise BadInput(f"{name} is too large", expected=f"at most {MAX_FILE_BYTES} bytes")
    if sum(map(len, files.values())) > MAX_BYTES:
        raise BadInput("the package is too large", expected=f"at most {MAX_BYTES} bytes in all files")
