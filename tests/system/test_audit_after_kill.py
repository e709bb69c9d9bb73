"""After kill -9 every change that was acknowledged has its audit row."""

from __future__ import annotations

import threading
import time

import httpx2


def test_no_acknowledged_change_lacks_its_audit_row(serve):
    """After the server was killed during changes, three times, every acknowledged change is in the audit log."""
    acknowledged_ids: list[int] = []
    for round_number in range(3):
        server = serve()
        stop = threading.Event()

        def change(console=server.console, first=round_number * 2, stop=stop) -> None:
            number = 0
            while not stop.is_set():
                number += 1
                body = {"name": f"t{first}-{threading.get_ident()}-{number}", "role": "viewer", "days": 1}
                try:
                    reply = console.http.post("/tokens", json=body)
                    if reply.status_code == 201:
                        acknowledged_ids.append(reply.json()["token"]["id"])
                        console.http.delete(f"/tokens/{acknowledged_ids[-1]}")
                except (httpx2.HTTPError, OSError):
                    return

        threads = [threading.Thread(target=change) for _ in range(2)]
        for thread in threads:
            thread.start()
        time.sleep(1.5)
        server.kill()
        stop.set()
        for thread in threads:
            thread.join()
    console = serve().console
    rows = []
    while page := console.get("/audit", limit=500, **({"before": rows[-1]["seq"]} if rows else {})):
        rows += page
    created = [row for row in rows if row["action"] == "tokens.add_token"]
    stored = {row["name"] for row in console.get("/tokens")}
    named = {row["detail"].split(" as ")[0] for row in created if row["result"] == "done"}
    unknown = sum(row["result"] == "unknown" for row in created)
    assert len(acknowledged_ids) > 10
    assert len(stored - named) <= unknown
