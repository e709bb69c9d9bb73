"""Read input files of the command line up to a size limit.

Files that a library decodes (images, star lists, tables) are then parsed in a child process, see
:mod:`gss.operations.parsing`. Text and bank images are parsed in this process, because their parsers take linear time.
"""

from __future__ import annotations

from pathlib import Path

from gss.domain.errors import BadInput

TEXT_BYTES = 16 << 20
TLE_BYTES = 4 << 10
IMAGE_BYTES = 64 << 20
"""Limit for a bank image, well above the largest flash."""
TABLE_FILE_BYTES = 256 << 20


def read_limited(path: Path, max_bytes: int) -> bytes:
    """Return the content of a file. Raises BadInput if it is larger than ``max_bytes``, OSError if it cannot be
    read."""
    with path.open("rb") as file:
        data = file.read(max_bytes + 1)
    if len(data) > max_bytes:
        raise BadInput(
            f"{path.name} is too large", expected=f"at most {max_bytes} bytes", got=f"more than {max_bytes} bytes"
        )
    return data


def read_file(name: str, kind: str, max_bytes: int) -> bytes:
    """Return the content of a file named on the command line. ``kind``: expected kind, for the error message. Raises
    BadInput if the file is missing, unreadable or larger than ``max_bytes``."""
    try:
        return read_limited(Path(name), max_bytes)
    except IsADirectoryError:
        raise BadInput(f"{name} is a directory", expected=kind, got="a directory") from None
    except FileNotFoundError:
        raise BadInput(f"{name} does not exist", expected=kind, got="no such file") from None
    except OSError as error:
        raise BadInput(f"{name} cannot be read", expected="a readable file", got=str(error.strerror or error)) from None
