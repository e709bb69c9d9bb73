"""Attitude messages over HTTP: a costly file does not fill the server's memory."""

from __future__ import annotations

import resource

from fastapi.testclient import TestClient


def test_a_file_of_very_many_lines_is_read_outside_the_server(client: TestClient) -> None:
    """Ten million lines would take more than a gigabyte; a viewer may send them."""
    before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    data = b"CCSDS_AEM_VERS = 1.0\n" + b"1\n" * 4_000_000
    answer = client.post("/api/attitudes/compare", files={"file": ("adcs.aem", data)})
    assert answer.status_code == 400, answer.text
    assert answer.json()["message"]
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kib < 300 << 10
