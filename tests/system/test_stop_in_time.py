"""The server ends within seconds of a signal during calculations, and the next one continues the jobs."""

from __future__ import annotations

import signal

import pytest


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_the_server_stops_in_time_while_it_computes(serve, end):
    """An experiment of a million trials and the tables of the first solution are under way; the next server takes
    the job up without counting a crash.
    """
    server = serve("--simulator", "cubestar")
    body = {"names": ["jacobs-5-1"], "trials": 1_000_000}
    job = server.console.post("/campaigns/experiments", body)
    server.console.wait("the job to run", lambda: server.console.get(f"/jobs/{job['id']}")["state"] == "running")
    server.stop(end, within_s=10.0)  # the server promises 5 s of an idle machine
    again = serve()
    again.console.wait("the job to run", lambda: again.console.get(f"/jobs/{job['id']}")["state"] == "running")
    assert again.console.get(f"/jobs/{job['id']}")["attempts"] == 0
    again.console.http.post(f"/jobs/{job['id']}/cancel")
