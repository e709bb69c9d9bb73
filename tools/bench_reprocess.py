"""Measure frames per second of a reprocessing job: read, solve, compare with the truth and store, on two workers."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from gss import __version__
from gss.instruments.registry import shipped_camera
from gss.operations.frames.frame_values import frame_values
from gss.store import frames as store
from gss.store.models import Frame
from tools.bench_frames import CHAIN_SEED, frames_of
from tools.bench_tables import BenchTable, Value

if TYPE_CHECKING:
    from gss.wiring.services import Services

CAMERA, CHAINS = "cubestar", ("reference", "cubestar")
TIMEOUT_S, POLL_S = 600.0, 0.1


def reprocessing(quick: bool) -> list[BenchTable]:
    """Return the rates of both chains of one camera."""
    from gss.settings import Settings
    from gss.wiring.build import build

    count = 40 if quick else 1500
    rows: list[tuple[str, dict[str, Value]]] = []
    with tempfile.TemporaryDirectory() as folder:
        services = build(Settings(data=Path(folder)))
        services.start()
        try:
            _store(services, count)
            rows.extend((f"chain {chain}", _measured(services, chain, count)) for chain in CHAINS)
        finally:
            services.stop()
    conditions = (
        f"The job of the page over {count} stored frames of {CAMERA} (rendered, 40 attitudes, one pixel of each frame "
        "differs): two workers read, solve and compare each frame with its truth, and the server stores the results in "
        "SQLite in a temporary folder. Wall clock from the first to the last result, without the start of the workers."
    )
    return [BenchTable("reprocess", "Reprocessing stored frames", conditions, CHAIN_SEED, rows)]


def _store(services: Services, count: int) -> None:
    """Store frames with their truths."""
    camera, base = shipped_camera(CAMERA), services.base
    drawn = list(frames_of(camera, 40))
    with base.database.unit_of_work() as session:
        for k in range(count):
            pixels, truth = drawn[k % len(drawn)]
            pixels = pixels.copy()
            pixels.flat[k] ^= 1
            values = {"source": "import", "taken": base.clock.now(), "profile": CAMERA, "bits": 8}
            row = frame_values(pixels, camera, values) | {"truth": [float(q) for q in truth.quaternion]}
            key = base.blobs.put(pixels.tobytes(), pixels.itemsize)
            store.add(session, Frame(name="", received=base.clock.now(), complete=True, sha256=key, **row))


def _measured(services: Services, chain: str, count: int) -> dict[str, Value]:
    from gss.operations.studies.reprocess import ReprocessRequest

    services.studies.reprocessing.start(ReprocessRequest(chain=chain, again=True), user="bench")
    first = done = 0
    started_s = ended_s = 0.0
    deadline_s = time.perf_counter() + TIMEOUT_S
    while done < count and time.perf_counter() < deadline_s:
        time.sleep(POLL_S)
        with services.base.database.unit_of_work() as session:
            done = len(store.solved_by(session, chain, __version__, ""))
        ended_s = time.perf_counter()
        if done and not first:
            first, started_s = done, ended_s
    if done != count:
        raise RuntimeError(f"only {done} of {count} frames were solved within {TIMEOUT_S:.0f} s")
    return {"frames": done, "frames_per_s": round((done - first) / max(ended_s - started_s, 1e-9))}
