"""Fingerprint of the sources that determine the results of experiments."""

from __future__ import annotations

import hashlib
from pathlib import Path

import gss
import validation

FOLDERS = ("domain", "skytables", "instruments", "pipeline", "catalogue_tools")


def fingerprint() -> str:
    """Return twelve hexadecimal digits that identify the Python files and the instrument packages (YAML) in ``FOLDERS``
    of gss and in this package."""
    root, own_folder = Path(gss.__file__).parent, Path(validation.__file__).parent
    digest = hashlib.sha256()
    for folder in (*(root / name for name in FOLDERS), own_folder):
        for path in sorted(p for p in folder.rglob("*") if p.suffix in (".py", ".yaml")):
            digest.update(path.relative_to(folder.parent).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:12]
