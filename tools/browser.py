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
    "--disable-gpu",  # painting through a software GPU costs five times the processor; WebGL comes by SwiftShader all the same
    "--enable-unsafe-swiftshader",
]


def chromium() -> str | None:
    """The browser's program."""
    return shutil.which("chromium")


def launch_options() -> dict[str, Any]:
    """For playwright's launch."""
    return {"executable_path": chromium(), "args": FLAGS}
