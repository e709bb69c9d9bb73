"""Remove from the virtual environment what running GSS does not need: ``python -m tools.slim``, a step of ``make run``.

Wheels contain more than a library: Rerun's holds a desktop program of 0.3 GB, others their test suites and headers.
Nothing that GSS imports is removed; ``make test`` runs in the same environment.
"""

from __future__ import annotations

import shutil
import sysconfig
from pathlib import Path

PROGRAM = "rerun_cli/rerun"
"""Rerun's desktop program. Pages and recordings use the library; ``pip install --force-reinstall rerun-sdk`` brings
the program back."""
UNUSED = ("setuptools", "pkg_resources", "pyarrow/include", "pyarrow/src")
TESTED = ("astropy", "numpy", "pyarrow", "scipy")
"""Packages whose test suites are removed."""
IMPORTED = ("astropy/tests",)
"""Folders called ``tests`` that their package imports."""


def unneeded(packages: Path) -> list[Path]:
    """Return the files and folders of ``packages`` (a site-packages folder) that GSS never uses."""
    paths = [path for name in (PROGRAM, *UNUSED) if (path := packages / name).exists()]
    suites = [folder for name in TESTED for folder in (packages / name).rglob("tests")]
    return paths + [folder for folder in suites if folder.relative_to(packages).as_posix() not in IMPORTED]


def size(path: Path) -> int:
    """Return the bytes of a file or of all files in a folder."""
    return path.stat().st_size if path.is_file() else sum(p.stat().st_size for p in path.rglob("*") if p.is_file())


def main() -> None:
    """Remove and say how much."""
    freed = 0
    for path in unneeded(Path(sysconfig.get_path("purelib"))):
        freed += size(path)
        if path.is_file():
            path.unlink()
        else:
            shutil.rmtree(path, ignore_errors=True)  # a folder of tests can contain another one
    print(f"removed {freed / 1e6:.0f} MB that running does not need (tools/slim.py)")


if __name__ == "__main__":
    main()
