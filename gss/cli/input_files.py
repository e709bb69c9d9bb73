"""Input files of the command line, read up to a stated size.

Files that a library decodes (images, star lists, tables) are then parsed in a child process, see :mod:`gss.operations.parsing`.
Text and bank images are parsed here: their parsers are linear, so that the size limits the time.
"""

from __future__ import annotations

from pathlib import Path

from gss.domain.errors import BadInput

TEXT_BYTES = 16 << 20
TLE_BYTES = 4 << 10
IMAGE_BYTES = 64 << 20
"""Of a bank image; the largest flash has a small part of it."""
TABLE_FILE_BYTES = 256 << 20


def read_limited(path: Path, most_bytes: int) -> bytes:
    """The bytes of a file; BadInput if there are more. OSError as the system reports it."""
    with path.open("rb") as file:
        data = file.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise BadInput(
            f"{path.name} is too large", expected=f"at most {most_bytes} bytes", got=f"more than {most_bytes} bytes"
        )
    return data
