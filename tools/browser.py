"""How measurements start Debian's chromium."""

from __future__ import annotations

import shutil
from typing import Any

FLAGS = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


def chromium() -> str | None:
    """The browser's program."""
    return shutil.which("chromium")


def launch_options() -> dict[str, Any]:
    """For playwright's launch."""
    return {"executable_path": chromium(), "args": FLAGS}
