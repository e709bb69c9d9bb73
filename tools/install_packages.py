"""Install the packages of a lock file into the environment of this Python: ``python -m tools.install_packages FILE``.

uv is several times faster than pip. It is installed into a temporary folder and is not part of the environment. uv does not read
the configuration of pip, for example a private index; if it cannot install the packages, pip does. Both verify all hashes.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from tools.build_web import PIP_INSTALL, install_pinned


def with_uv(lock_file: str, folder: Path) -> bool:
    """Install the packages with uv. Returns False if this is not possible."""
    try:
        install_pinned("uv", folder)
    except subprocess.CalledProcessError:
        return False
    uv = [str(folder / "bin" / "uv"), "pip", "install", "--quiet", "--python", sys.executable]
    return subprocess.run([*uv, "--require-hashes", "-r", lock_file]).returncode == 0


def with_pip(lock_file: str) -> bool:
    """Install the packages with pip. Returns False if this is not possible."""
    return subprocess.run([*PIP_INSTALL, "-r", lock_file]).returncode == 0


def main(lock_file: str) -> int:
    """Install the packages and return the exit code."""
    with tempfile.TemporaryDirectory(prefix="gss-uv-") as folder:
        if with_uv(lock_file, Path(folder)):
            return 0
    print("uv cannot install the packages here; pip installs them, which takes some minutes …", flush=True)
    return 0 if with_pip(lock_file) else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
