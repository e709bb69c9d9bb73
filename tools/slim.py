"""Remove files that GSS does not need from the virtual environment: ``python -m tools.slim``, a step of ``make run``.

Some wheels contain more than a library: the wheel of Rerun contains a desktop program of 0.3 GB, others contain test
suites and headers. Nothing that GSS imports is removed; ``make test`` runs in the same environment.
"""

from __future__ import annotations

import shutil
import sysconfig
from pathlib import Path

PROGRAM = "rerun_cli/rerun"
"""Rerun's desktop program. Pages and recordings use only the library; ``pip install --force-reinstall rerun-sdk``
restores the program."""
UNUSED = ("setuptools", "pkg_resources", "pyarrow/include", "pyarrow/src")
UNUSED_LIBRARIES = ("flight", "python_flight", "s3")
"""Parts of Apache Arrow for remote services. Telemetry files and Rerun use only Arrow's tables and Parquet."""
UNUSED_BACKENDS = "zstandard/_cffi*.so"
"""The second of two implementations in the package, which CPython does not use."""
PACKAGES_WITH_TESTS = ("astropy", "h5py", "llvmlite", "numba", "numpy", "pyarrow", "scipy", "zmq")
"""Packages whose test suites are removed."""
PACKAGES_WITH_SOURCES = ("astropy", "fontTools", "pyarrow", "scipy")
SOURCES = (".c", ".cpp", ".pxi", ".pyx")
"""Sources of compiled modules, which these packages install beside them."""
IMPORTED = ("astropy/tests",)
"""Folders named ``tests`` that their package imports."""


def unneeded(packages: Path) -> list[Path]:
    """Return the files and folders of ``packages`` (a site-packages folder) that GSS never uses."""
    paths = [path for name in (PROGRAM, *UNUSED) if (path := packages / name).exists()]
    suites = [folder for name in PACKAGES_WITH_TESTS for folder in (packages / name).rglob("tests")]
    libraries = [file for name in UNUSED_LIBRARIES for file in packages.glob(f"pyarrow/libarrow_{name}.so*")]
    libraries += packages.glob(UNUSED_BACKENDS)
    sources = [
        file for name in PACKAGES_WITH_SOURCES for file in (packages / name).rglob("*") if file.suffix in SOURCES
    ]
    tests = [folder for folder in suites if folder.relative_to(packages).as_posix() not in IMPORTED]
    return paths + libraries + tests + [file for file in sources if "tests" not in file.relative_to(packages).parts]


def size(path: Path) -> int:
    """Return the size of a file, or of all files in a folder, in bytes."""
    return path.stat().st_size if path.is_file() else sum(p.stat().st_size for p in path.rglob("*") if p.is_file())


def main() -> None:
    """Remove the files and print their total size."""
    freed = 0
    for path in unneeded(Path(sysconfig.get_path("purelib"))):
        freed += size(path)
        if path.is_file():
            path.unlink()
        else:
            shutil.rmtree(path, ignore_errors=True)  # a folder of tests can contain another folder of tests
    print(f"Removed {freed / 1e6:.0f} MB that GSS does not need (tools/slim.py)")


if __name__ == "__main__":
    main()
