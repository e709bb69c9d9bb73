"""On-disk cache of the blind solver's pattern dictionaries. A new process then does not need to rebuild them. The name
of a file is the hash of the data from which the dictionary was built. A damaged or incompatible file is rebuilt and
overwritten.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from gss.pipeline.identify.patterns import PatternLevel, build_level
from gss.pipeline.identify.verify import SkyCatalogue

FORMAT = 1
NAMES = ("stars", "size_rad", "codes")


def users_folder() -> Path:
    """Return the user's cache folder for this program."""
    cache_home = os.environ.get("XDG_CACHE_HOME")
    return (Path(cache_home) if cache_home else Path.home() / ".cache") / "gss"


class FigureFiles:
    """Dictionaries in a folder. Missing dictionaries are built. Several processes can share the folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def levels(self, sky: SkyCatalogue) -> Callable[[float], PatternLevel]:
        """Return a function that returns the dictionary of a radius for one sky, from the disk if available."""
        content = hashlib.sha256(f"{FORMAT} ".encode() + np.ascontiguousarray(sky.icrs).tobytes()).hexdigest()
        return lambda radius_rad: self._level(sky, radius_rad, content)

    def _level(self, sky: SkyCatalogue, radius_rad: float, content: str) -> PatternLevel:
        key = hashlib.sha256(f"{content} {radius_rad!r}".encode()).hexdigest()[:32]
        path = self._folder / f"figures-{key}.npz"
        level = _read(path, sky, radius_rad)
        if level is None:
            level = build_level(sky, radius_rad)
            # If the disk is full or read-only, the next process rebuilds the dictionary.
            with contextlib.suppress(OSError):
                _write(path, level)
        return level


def _read(path: Path, sky: SkyCatalogue, radius_rad: float) -> PatternLevel | None:
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as archive:
            stars, size_rad, codes = (archive[name] for name in NAMES)
            count = int(archive["bright_count"])
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    is_consistent = stars.shape == codes.shape == (len(size_rad), 4) and 0 < count <= len(sky) and stars.size
    if not is_consistent or stars.min() < 0 or stars.max() >= count:
        return None
    return PatternLevel(radius_rad, stars, size_rad, cKDTree(codes), cKDTree(sky.icrs[:count]), count)


def _write(path: Path, level: PatternLevel) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    data = io.BytesIO()
    np.savez(
        data,
        stars=level.stars,
        size_rad=level.size_rad,
        codes=np.asarray(level.tree.data),
        bright_count=np.int64(level.bright_count),
    )
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=path.stem, delete=False) as part:
        part.write(data.getvalue())
    os.replace(part.name, path)
