"""Fingerprint of the sources that determine the results of experiments."""

from __future__ import annotations

import hashlib
from pathlib import Path

import gss
import validation

FOLDERS = ("domain", "skytables", "instruments", "pipeline", "catalogue_tools")
STORAGE = {
    f"validation/{name}.py"
    for name in (
        "cli",
        "fingerprint",
        "result_store",
        "never_wrong/campaign",
        "never_wrong/fixed_cases",
        "never_wrong/page",
        "never_wrong/record",
        "never_wrong/search",
    )
}
"""Files that start runs, store results, and write pages or contain their texts, and do not change a result."""


def fingerprint() -> str:
    """Return twelve hexadecimal digits that identify the Python files, the instrument packages (YAML) and the star tables in
    ``FOLDERS`` of gss and in this package, without those in ``STORAGE``."""
    root, own_folder = Path(gss.__file__).parent, Path(validation.__file__).parent
    digest = hashlib.sha256()
    for folder in (*(root / name for name in FOLDERS), own_folder):
        for path in sorted(p for p in folder.rglob("*") if p.suffix in (".py", ".yaml", ".npz")):
            name = path.relative_to(folder.parent).as_posix()
            if name not in STORAGE:
                digest.update(name.encode() + path.read_bytes())
    return digest.hexdigest()[:12]
