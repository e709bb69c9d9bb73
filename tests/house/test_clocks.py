"""Time is an argument: only a few files read this computer's clock."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2] / "gss"
READS = re.compile(
    r"\btime\.(?:time|time_ns|monotonic|perf_counter|thread_time)\b|\bdatetime\.(?:now|utcnow)\b|\bperf_counter\b"
)
MACHINE_TIME = {
    "api/request_counts.py": "how long a request took",
    "cli/catalogue.py": "how long a build took",
    "client/client.py": "timeouts on the client's machine",
    "client/connection.py": "timeouts on the client's machine",
    "device/can_stream.py": "timeouts of a socket",
    "device/simulator/simulated_time.py": "real time that simulated time is derived from",
    "device/zmq_stream.py": "timeouts of a socket",
    "operations/catalogues/build_catalogue.py": "how long a build took",
    "operations/catalogues/design.py": "how long a calculation took",
    "operations/clock.py": "the clocks themselves",
    "operations/studies/dask_executor.py": "timeouts of workers",
    "store/deadline.py": "timeout of the object store",
}


def test_only_these_files_read_the_clock_of_the_machine():
    """Only the listed files read the computer's clock, each with a reason.

    All other code receives a clock, so that a rehearsal can set mission time.
    """
    readers = {
        str(path.relative_to(ROOT))
        for path in ROOT.rglob("*.py")
        if READS.search(path.read_text("utf-8")) and "web" not in path.relative_to(ROOT).parts
    }
    assert readers == set(MACHINE_TIME)
