"""Remove files that GSS does not need from the virtual environment: ``python -m tools.slim``, a step of ``make run``.

Some wheels contain more than a library: the wheel of Rerun contains a desktop program of 0.3 GB, others contain test
suites and headers. Nothing that GSS imports is removed; ``make test`` runs in the same environment.

Compiled modules contain names of their functions for debuggers, a sixth of the environment. They are removed as the program
strip does, which not every machine has.
"""

from __future__ import annotations

import os
import shutil
import struct
import sysconfig
from pathlib import Path

PROGRAM = "rerun_cli/rerun"
"""Rerun's desktop program. Pages and recordings use only the library; ``pip install --force-reinstall rerun-sdk``
restores the program."""
UNUSED = ("setuptools", "pkg_resources", "pyarrow/include", "pyarrow/src")
UNUSED_LIBRARIES = (
    "libarrow_flight",
    "libarrow_python_flight",
    "libarrow_s3",
    "_flight",
    "_s3fs",
    "_pyarrow_cpp_tests",
)
"""Parts of Apache Arrow for remote services and its tests. Telemetry files and Rerun use only Arrow's tables and Parquet."""
BILLS_OF_MATERIALS = "*.dist-info/sboms"
UNUSED_BACKENDS = "zstandard/_cffi*.so"
"""The second of two implementations in the package, which CPython does not use."""
PACKAGES_WITH_TESTS = ("astropy", "h5py", "llvmlite", "numba", "numpy", "pyarrow", "scipy", "zmq")
"""Packages whose test suites are removed."""
PACKAGES_WITH_SOURCES = ("astropy", "fontTools", "pyarrow", "scipy")
SOURCES = (".c", ".cpp", ".pxi", ".pyx")
"""Sources of compiled modules, which these packages install beside them."""
IMPORTED = ("astropy/tests",)
"""Folders named ``tests`` that their package imports."""
ELF_64_LITTLE = b"\x7fELF\x02\x01"
ELF_HEADER = struct.Struct("<6s26xQ16xH")
"""Start of an ELF file: magic number, offset of the table of segments, number of segments."""
SEGMENT = struct.Struct("<8xQ16xQ16x")
"""Entry of the table of segments: offset and size in the file."""
SECTIONS, SECTION_TABLE = struct.Struct("<Q"), 40
SECTION_COUNTS, SECTION_COUNT = struct.Struct("<2H"), 60
"""Offset of the table of sections, and their number and the number of the section of names, with their places in the file."""


def unneeded(packages: Path) -> list[Path]:
    """Return the files and folders of ``packages`` (a site-packages folder) that GSS never uses."""
    paths = [path for name in (PROGRAM, *UNUSED) if (path := packages / name).exists()]
    suites = [folder for name in PACKAGES_WITH_TESTS for folder in (packages / name).rglob("tests")]
    libraries = [file for name in UNUSED_LIBRARIES for file in packages.glob(f"pyarrow/{name}.*so*")]
    libraries += [*packages.glob(UNUSED_BACKENDS), *packages.glob(BILLS_OF_MATERIALS)]
    sources = [
        file for name in PACKAGES_WITH_SOURCES for file in (packages / name).rglob("*") if file.suffix in SOURCES
    ]
    tests = [folder for folder in suites if folder.relative_to(packages).as_posix() not in IMPORTED]
    return paths + libraries + tests + [file for file in sources if "tests" not in file.relative_to(packages).parts]


def size(path: Path) -> int:
    """Return the size of a file, or of all files in a folder, in bytes."""
    return path.stat().st_size if path.is_file() else sum(p.stat().st_size for p in path.rglob("*") if p.is_file())


def loaded_bytes(content: memoryview) -> int | None:
    """Return the size of the part of a compiled module that the system reads when it loads the module; None if the file is
    not a 64-bit little-endian ELF file. The sections after this part are only for linkers and debuggers."""
    if len(content) < ELF_HEADER.size:
        return None
    magic, table, count = ELF_HEADER.unpack_from(content)
    if magic != ELF_64_LITTLE or table + count * SEGMENT.size > len(content):
        return None
    end: int = table + count * SEGMENT.size
    for k in range(count):
        offset, size = SEGMENT.unpack_from(content, table + k * SEGMENT.size)
        end = max(end, offset + size)
    return end


def drop_symbols(file: Path) -> int:
    """Remove the names for debuggers from a compiled module, and return the number of bytes removed. The file is replaced,
    because it can be a link to the installer's cache."""
    content = bytearray(file.stat().st_size)
    with file.open("rb") as module:
        module.readinto(content)
    end = loaded_bytes(memoryview(content))
    if end is None or end >= len(content):
        return 0
    SECTIONS.pack_into(content, SECTION_TABLE, 0)
    SECTION_COUNTS.pack_into(content, SECTION_COUNT, 0, 0)
    smaller = file.with_name(f"{file.name}.slim")
    smaller.write_bytes(memoryview(content)[:end])
    shutil.copymode(file, smaller)
    os.replace(smaller, file)
    return len(content) - end


def main() -> None:
    """Remove the files and symbols, and print their total size."""
    packages, freed = Path(sysconfig.get_path("purelib")), 0
    for path in unneeded(packages):
        freed += size(path)
        if path.is_file():
            path.unlink()
        else:
            shutil.rmtree(path, ignore_errors=True)  # a folder of tests can contain another folder of tests
    freed += sum(drop_symbols(file) for file in packages.rglob("*.so*") if file.is_file() and not file.is_symlink())
    print(f"Removed {freed / 1e6:.0f} MB that GSS does not need (tools/slim.py)")


if __name__ == "__main__":
    main()
