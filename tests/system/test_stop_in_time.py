"""The server ends within seconds of a signal during calculations, and the next one continues the jobs."""

from __future__ import annotations

import signal


def test_the_server_stops_in_time_while_it_computes(serve):
    """An experiment of a million trials and the tables of the first solution are under way at each signal; the next server
    takes the job up without counting a crash.
    """
    body = {"names": ["jacobs-5-1"], "trials": 1_000_000}
    server = serve("--simulator", "cubestar")
    job = server.console.post("/campaigns/experiments", body)["id"]
    for end in (signal.SIGINT, signal.SIGTERM):
        _runs(server.console, job)
        server.stop(end, within_s=10.0)  # the server promises 5 s of an idle machine
        server = serve("--simulator", "cubestar")
    _runs(server.console, job)
    assert server.console.get(f"/jobs/{job}")["attempts"] == 0
    server.console.http.post(f"/jobs/{job}/cancel")


def _runs(console, job: int) -> None:
    console.wait("the job to run", lambda: console.get(f"/jobs/{job}")["state"] == "running")
