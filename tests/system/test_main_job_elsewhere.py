"""The main job with external storage and workers.

Rows are in PostgreSQL, frames and flash images in an object store; two API workers access both directly.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gss.catalogue_tools.onboard import decode

pytestmark = [pytest.mark.timeout(240), pytest.mark.postgres]
PASSWORD = "never-to-be-logged"
BUCKET = "frames-of-the-main-job"


@pytest.fixture
def elsewhere(postgres_url: str, s3_server: str) -> dict[str, str]:
    """The environment of a server whose database and blobs are elsewhere; both are empty."""
    from sqlalchemy import create_engine, text

    engine = create_engine(postgres_url)
    with engine.begin() as connection:
        connection.execute(text("DROP SCHEMA public CASCADE"))
        connection.execute(text("CREATE SCHEMA public"))
    engine.dispose()
    return {
        "GSS_DATABASE": postgres_url.replace("gss@", f"gss:{PASSWORD}@"),
        "GSS_BLOBS": f"s3://{BUCKET}/gss",
        "AWS_ENDPOINT_URL_S3": s3_server,
        "AWS_ACCESS_KEY_ID": "tester",
        "AWS_SECRET_ACCESS_KEY": PASSWORD,
        "AWS_DEFAULT_REGION": "us-east-1",
    }


@pytest.fixture
def bucket(elsewhere: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> Any:
    """Client of the object store, independent of the server."""
    s3fs = pytest.importorskip("s3fs")
    for name, value in elsewhere.items():
        if name.startswith("AWS_"):
            monkeypatch.setenv(name, value)
    s3fs.S3FileSystem.clear_instance_cache()
    fs = s3fs.S3FileSystem(use_listings_cache=False)
    if not fs.exists(BUCKET):
        fs.mkdir(BUCKET)
    return fs


def test_the_main_job_runs_on_postgresql_and_an_object_store(
    serve: Callable[..., Any], elsewhere: dict[str, str], bucket: Any, tmp_path: Path
) -> None:
    """Command, frame, solution, import, catalogue and upload are stored and present after a restart. The data folder contains
    neither rows nor pixels."""
    server = serve("--simulator", "cubestar", "--workers", "2", **elsewhere)
    console = server.console
    console.wait("the sensor's banks", lambda: (console.get("/link")["active_bank"] or {}).get("catalogue_id"), 60)
    completed(console, "TAKE_IMAGE")
    console.wait("the frame", lambda: console.get("/frames")["frames"], 60)  # a download takes longer on a busy machine
    for step in ("FIND_CENTROIDS", "MATCH_STARS", "CALCULATE_ATTITUDE"):
        completed(console, step)

    def compared() -> Any:
        frame = console.get("/frames")["frames"]
        detail = console.get(f"/frames/{frame[0]['id']}") if frame else {}
        return detail if detail.get("comparison") and detail["on_board"]["replay"] else None

    detail = console.wait("comparison and replay", compared)
    assert detail["comparison"]["agree"], detail["comparison"]
    pixels = console.http.get(f"/frames/{detail['id']}/raw").content

    file = console.http.get(f"/frames/{detail['id']}/file.fits").content
    answer = console.http.post("/frames/import", files={"file": ("sky.fits", file)}, data={"profile": "cubestar"})
    assert answer.status_code == 201, answer.text
    imported = console.wait(
        "the import to be solved",
        lambda: next((d for d in [console.get(f"/frames/{answer.json()['id']}")] if d["ground"]), None),
    )
    assert imported["ground"]["outcome"] == "solved"

    request = {"name": "all-sky-36", "faint_mag": 3.6, "profile": "cubestar", "format": "cubestar"}
    job = console.post("/catalogues", request, status=202)
    done = console.wait(
        "the build", lambda: next((j for j in [console.get(f"/jobs/{job['id']}")] if j["state"] == "done"), None)
    )
    catalogue = console.get(f"/catalogues/{done['result']['catalogue_id']}")
    assert len(decode(console.http.get(f"/catalogues/{catalogue['id']}/image.bin").content)) == catalogue["stars"]
    transfer = console.post(f"/catalogues/{catalogue['id']}/upload", {"bank": "B"})
    sent = console.wait(
        "the upload",
        lambda: next(
            (
                t
                for t in [console.get(f"/transfers/{transfer['id']}")]
                if t["state"] in ("committed", "failed", "aborted")
            ),
            None,
        ),
    )
    assert (sent["state"], sent["sha256"]) == ("committed", catalogue["sha256"])
    stored = console.get("/telemetry/packets", packet="housekeeping", limit=5)
    assert stored
    assert stored[0]["id"] > stored[-1]["id"]
    span = {"start": "2020-01-01T00:00:00Z", "end": console.get("/link")["utc"], "points": 100}
    (supply,) = console.get("/telemetry/history", name=["supply_3v3_v"], **span)["series"]
    assert all(3.0 < y < 3.6 for y in supply["y"])
    chain = console.post("/campaigns/reprocess", {"chain": "cubestar"})
    ran = console.wait(
        "reprocessing",
        lambda: next(
            (j for j in [console.get(f"/jobs/{chain['id']}")] if j["state"] not in ("queued", "running")), None
        ),
        60,
    )
    assert ran["state"] == "done", ran

    other = serve_refused(tmp_path, elsewhere)
    assert "Another server runs on this database" in other
    server.stop()
    held = {name.rsplit("/", 2)[1] + name.rsplit("/", 1)[1] for name in bucket.find(f"{BUCKET}/gss")}
    assert {detail["sha256"], catalogue["sha256"]} <= held
    assert not (tmp_path / "data" / "gss.db").exists()
    assert not (tmp_path / "data" / "blobs").exists()

    again = serve(**elsewhere)
    assert again.console.http.get(f"/frames/{detail['id']}/raw").content == pixels
    assert again.console.get(f"/catalogues/{catalogue['id']}")["sha256"] == catalogue["sha256"]
    again.stop()
    logs = "".join(p.read_text(errors="replace") for p in tmp_path.glob("*.log"))
    assert PASSWORD not in logs + other


def completed(console: Any, name: str) -> None:
    """Send an idempotent command until its result is known. On a busy machine, a simulated sensor that loads its compiled
    loops may not respond within two seconds."""

    def known() -> Any:
        ended = console.command(name)
        return None if ended["result"] == "unknown" else ended

    ended = console.wait(f"{name} to be answered", known, 60)
    assert ended["result"] == "completed", ended


def serve_refused(folder: Path, elsewhere: dict[str, str]) -> str:
    """Return the output of a second server on the same database, which ends with an error."""
    import os
    import subprocess
    import sys

    command = [sys.executable, "-m", "gss", "serve", "--port", "0", "--data", str(folder / "second")]
    ended = subprocess.run(command, env={**os.environ, **elsewhere}, capture_output=True, text=True, timeout=60)
    assert ended.returncode != 0
    return ended.stdout + ended.stderr
