"""Options for starting Debian's chromium in measurements and tests."""

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
    """Return the path of the browser for measurements; None if no browser is installed."""
    return shutil.which("chromium") or shutil.which("chromium-headless-shell")


def chromium_for_tests() -> str | None:
    """Return the path of the browser for tests; None if no browser is installed. The old headless mode uses a third less
    processor time, because it has no windows."""
    return shutil.which("chromium-headless-shell") or shutil.which("chromium")


def launch_options(path: str | None = None) -> dict[str, Any]:
    """Return the options for playwright's launch. ``path``: the browser; without it, the browser for measurements."""
    return {"executable_path": path or chromium(), "args": FLAGS}
