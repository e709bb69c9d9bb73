"""Files that ``make run`` removes from its environment."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from tools.slim import drop_symbols, unneeded


def test_the_program_and_test_suites_are_removed(tmp_path: Path) -> None:
    """The program of Rerun, the unused backend of zstandard, test suites, and sources of compiled modules are removed.
    Imported files, headers and files of other packages are not.
    """
    for name in (
        "rerun_cli/rerun",
        "pyarrow/libarrow_s3.so.1",
        "pyarrow/_s3fs.cpython.so",
        "rerun_sdk-1.dist-info/sboms/list.json",
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
        "pyarrow/_fs.cpython.so",
        "numpy/include/array.h",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    removed = {path.relative_to(tmp_path).as_posix() for path in unneeded(tmp_path)}
    assert removed == {
        "rerun_cli/rerun",
        "pyarrow/libarrow_s3.so.1",
        "pyarrow/_s3fs.cpython.so",
        "rerun_sdk-1.dist-info/sboms",
        "zstandard/_cffi.cpython.so",
        "pyarrow/lib.pyx",
        "fontTools/misc/bezier.c",
        "numba/tests",
        "scipy/stats/tests",
        "astropy/wcs/tests",
    }


def test_a_module_without_names_keeps_its_segments(tmp_path: Path) -> None:
    """Bytes after the last segment are removed, together with the references to them. A link to the same file, as in the
    installer's cache, keeps its content.
    """
    header = bytearray(64)
    header[:6] = b"\x7fELF\x02\x01"
    struct.pack_into("<QQ", header, 32, 64, 300)  # offsets of the tables of segments and sections
    struct.pack_into("<5H", header, 54, 56, 2, 64, 7, 6)  # size and number of segments and sections, names
    segments = b"".join(
        struct.pack("<IIQQQQQQ", 1, 5, start, 0, 0, size, size, 1) for start, size in ((0, 176), (176, 24))
    )
    module, cached = tmp_path / "module.so", tmp_path / "cached.so"
    cached.write_bytes(header + segments + b"code of the module......" + b"names" * 40)
    cached.chmod(0o755)
    module.hardlink_to(cached)
    before = cached.read_bytes()
    assert drop_symbols(module) == 200
    after = module.read_bytes()
    assert after[64:] == before[64:200]
    assert struct.unpack_from("<QQ", after, 32) == (64, 0)
    assert struct.unpack_from("<5H", after, 54) == (56, 2, 64, 0, 0)
    assert (cached.read_bytes(), module.stat().st_mode) == (before, cached.stat().st_mode)
    assert drop_symbols(module) == 0


@pytest.mark.parametrize(
    "content", [b"", b"\x7fELF", b"\x7fELF\x01\x01" + bytes(90), b"\x7fELF\x02\x01" + b"\xff" * 90]
)
def test_other_files_stay_unchanged(tmp_path: Path, content: bytes) -> None:
    """A file that is not a 64-bit module, or whose table of segments is outside the file, stays unchanged."""
    file = tmp_path / "other.so"
    file.write_bytes(content)
    assert drop_symbols(file) == 0
    assert file.read_bytes() == content
