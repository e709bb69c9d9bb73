"""Web files of the Rerun viewer, extracted from the installed SDK so that the page and the recordings have the same version.

The library of the SDK contains the files byte for byte. They are copied from there, because the SDK itself publishes them
only through a server without authentication. The cache folder is named after the version of the SDK.
"""

from __future__ import annotations

import gzip
import importlib.metadata
import importlib.util
import threading
from pathlib import Path
from typing import BinaryIO

from gss.domain.errors import GssError, NotFound

SCRIPT, PROGRAM = "re_viewer.js", "re_viewer_bg.wasm"
FILES = (SCRIPT, PROGRAM)
SCRIPT_BEGIN, SCRIPT_END = b"let wasm_bindgen = (function(exports) {\n", b"\n})({ __proto__: null });\n"
"""First and last line of the script that wasm-bindgen generates."""
MAX_SCRIPT_BYTES = 4 << 20
PROGRAM_BEGIN = b"\0asm\1\0\0\0"
"""Magic number and version of a WebAssembly module."""
CUSTOM_SECTION, LAST_SECTION_ID = 0, 13
LAST_SECTION = b"\x0ftarget_features"
"""Length and name of the custom section that the compiler writes last."""
SEARCH_BYTES = 1 << 20
"""Bytes that are searched at a time. Between two searches other threads can run."""


class RerunViewer:
    """Provides the viewer's files. The first call takes several seconds and caches the files on disk."""

    def __init__(self, cache: Path) -> None:
        self._cache = cache
        self._lock = threading.Lock()

    def file(self, name: str) -> bytes:
        """Return one of the viewer's files, gzip-compressed. Raises NotFound for other names."""
        if name not in FILES:
            raise NotFound("no such file of the viewer", expected=" | ".join(FILES), got=name)
        with self._lock:
            folder = self._cache / importlib.metadata.version("rerun-sdk")
            if not all((folder / f"{f}.gz").exists() for f in FILES):
                _extract(folder)
        return (folder / f"{name}.gz").read_bytes()


def _extract(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with _library().open("rb") as library:
        for name, data in ((SCRIPT, script(library)), (PROGRAM, program(library))):
            part = folder / f"{name}.gz.part"
            part.write_bytes(gzip.compress(data, compresslevel=6))
            part.rename(folder / f"{name}.gz")


def _library() -> Path:
    """Return the SDK's compiled library, without loading it."""
    package = importlib.util.find_spec("rerun_bindings")
    folders = list(package.submodule_search_locations or []) if package is not None else []
    libraries = [
        path for folder in folders for path in sorted(Path(folder).glob("rerun_bindings*.*")) if _is_binary(path)
    ]
    if not libraries:
        raise _absent("no compiled library in the package rerun_bindings")
    return libraries[0]


def _is_binary(path: Path) -> bool:
    return path.suffix in (".so", ".pyd", ".dylib")


def script(library: BinaryIO) -> bytes:
    """Return the viewer's script. Raises GssError if the library does not contain it."""
    begin = _find(library, SCRIPT_BEGIN)
    library.seek(begin)
    text = library.read(MAX_SCRIPT_BYTES)
    end = text.find(SCRIPT_END)
    if end < 0:
        raise _absent(f"the end of {SCRIPT} was not found")
    return text[: end + len(SCRIPT_END)]


def program(library: BinaryIO) -> bytes:
    """Return the viewer's WebAssembly module: the header and every section up to the last one. Raises GssError if the library
    does not contain it or if its sections are not as expected."""
    begin = _find(library, PROGRAM_BEGIN)
    end, name = begin + len(PROGRAM_BEGIN), b""
    while name != LAST_SECTION:
        library.seek(end)
        head = library.read(6 + len(LAST_SECTION))
        size, length = _leb128(head[1:6])
        if not head or head[0] > LAST_SECTION_ID or length == 0:
            raise _absent(f"{PROGRAM} has an unknown section at byte {end - begin}")
        name = head[1 + length :][: len(LAST_SECTION)] if head[0] == CUSTOM_SECTION else b""
        end += 1 + length + size
    library.seek(begin)
    return library.read(end - begin)


def _find(library: BinaryIO, pattern: bytes) -> int:
    """Return the position of the first occurrence of ``pattern``."""
    library.seek(0)
    start, kept = 0, b""
    while block := library.read(SEARCH_BYTES):
        window = kept + block
        if (at := window.find(pattern)) >= 0:
            return start - len(kept) + at
        start, kept = start + len(block), window[1 - len(pattern) :]
    raise _absent(f"{pattern[:20]!r} was not found")


def _leb128(data: bytes) -> tuple[int, int]:
    """Return an unsigned LEB128 number of at most 32 bits and its length in bytes; a length of 0 if it is not valid."""
    value = 0
    for k, byte in enumerate(data[:5]):
        value |= (byte & 0x7F) << 7 * k
        if byte < 0x80:
            return value, k + 1
    return 0, 0


def _absent(reason: str) -> GssError:
    version = importlib.metadata.version("rerun-sdk")
    return GssError(
        "the installed Rerun SDK does not contain the viewer as expected",
        expected="the version of rerun-sdk in constraints.txt",
        got=f"{version}: {reason}",
        hint="install GSS with its constraints file, or open the recording in the Rerun program",
    )
