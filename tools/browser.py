"""Options for starting Debian's chromium in measurements."""

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
    "--disable-gpu",  # a software GPU needs five times the processor time; WebGL still works
    "--enable-unsafe-swiftshader",
]


def chromium() -> str | None:
    """Return the path of the browser; None if it is not installed."""
    return shutil.which("chromium")


def launch_options() -> dict[str, Any]:
    """Return the options for playwright's launch."""
    return {"executable_path": chromium(), "args": FLAGS}
