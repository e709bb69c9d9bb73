"""Web files of the Rerun viewer, extracted from the installed SDK so that the page and the recordings have the same version.

The library of the SDK contains the viewer and can serve it. To extract the viewer, a separate Python process serves it
on loopback, the three files are copied, and the process is stopped. The cache folder is named after the version of the
SDK.
"""

from __future__ import annotations

import gzip
import importlib.metadata
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

from gss.domain.errors import GssError, NotFound

SERVE = """
import sys, time, rerun
rerun.init("viewer")
rerun.serve_web_viewer(web_port=int(sys.argv[1]), open_browser=False)
time.sleep(120)
"""
FILES = ("re_viewer.js", "re_viewer_bg.wasm", "favicon.ico")
START_WAIT_S = 20.0
POLL_S = 0.1


class RerunViewer:
    """Provides the viewer's files. The first call takes several seconds and caches the files on disk."""

    def __init__(self, cache: Path) -> None:
        self._cache = cache
        self._lock = threading.Lock()

    def file(self, name: str) -> bytes:
        """Return one of the viewer's files, gzip-compressed. Raises NotFound for other names."""
        if name not in FILES:
            raise NotFound("no such file of the viewer", expected=" | ".join(FILES), got=name)
        with self._lock:
            folder = self._cache / importlib.metadata.version("rerun-sdk")
            if not all((folder / f"{f}.gz").exists() for f in FILES):
                _extract(folder)
        return (folder / f"{name}.gz").read_bytes()


def _extract(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    web_port = _free_port()
    process = subprocess.Popen(  # noqa: S603 (this Python with our own text)
        [sys.executable, "-c", SERVE, str(web_port)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        for name in FILES:
            data = _fetch(f"http://127.0.0.1:{web_port}/{name}", process)
            part = folder / f"{name}.gz.part"
            part.write_bytes(gzip.compress(data, compresslevel=6))
            part.rename(folder / f"{name}.gz")
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _fetch(url: str, process: subprocess.Popen[bytes]) -> bytes:
    import httpx2  # imported here because it takes 0.3 s and the files are usually cached

    deadline_s = time.monotonic() + START_WAIT_S
    while True:
        try:
            reply = httpx2.get(url, timeout=START_WAIT_S, trust_env=False)
            return reply.raise_for_status().content
        except httpx2.HTTPError as error:
            if time.monotonic() > deadline_s or process.poll() is not None:
                raise GssError("no response from the Rerun viewer", got=str(error)) from error
            time.sleep(POLL_S)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
