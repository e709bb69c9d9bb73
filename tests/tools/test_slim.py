"""Files that ``make run`` removes from its environment."""

from __future__ import annotations

from pathlib import Path

from tools.slim import unneeded


def test_the_program_and_test_suites_are_removed(tmp_path: Path) -> None:
    """The program of Rerun, the unused backend of zstandard, test suites, and sources of compiled modules are removed.
    Imported files, headers and files of other packages are not.
    """
    for name in (
        "rerun_cli/rerun",
        "pyarrow/libarrow_s3.so.1",
        "zstandard/_cffi.cpython.so",
        "pyarrow/lib.pyx",
        "fontTools/misc/bezier.c",
        "numba/tests/test_d.py",
        "scipy/stats/tests/test_a.py",
        "scipy/stats/tests/data.c",
        "astropy/wcs/tests/test_b.py",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    for name in (
        "astropy/tests/helper.py",
        "rerun/__init__.py",
        "pyarrow/libarrow.so.1",
        "zstandard/backend_c.cpython.so",
        "other/tests/test_c.py",
        "other/code.c",
        "pyarrow/lib.pxd",
        "numpy/include/array.h",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    removed = {path.relative_to(tmp_path).as_posix() for path in unneeded(tmp_path)}
    assert removed == {
        "rerun_cli/rerun",
        "pyarrow/libarrow_s3.so.1",
        "zstandard/_cffi.cpython.so",
        "pyarrow/lib.pyx",
        "fontTools/misc/bezier.c",
        "numba/tests",
        "scipy/stats/tests",
        "astropy/wcs/tests",
    }
