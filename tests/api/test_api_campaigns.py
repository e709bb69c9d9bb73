"""Campaigns over HTTP: experiments and reprocessing as jobs, chains side by side."""

from __future__ import annotations

import csv
import io
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from pyarrow import parquet as pq

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.cli import main
from gss.domain.errors import GssError
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import shipped_camera
from gss.operations.jobs import Cancelled
from gss.operations.studies.reprocess import ReprocessRequest
from gss.pipeline.render import render
from gss.settings import Settings
from gss.wiring.build import build
from gss.wiring.services import Services

FRAMES = 9


@pytest.fixture(scope="module")
def services(tmp_path_factory: pytest.TempPathFactory) -> Services:
    """Services whose store holds nine rendered frames with their truth."""
    services = build(Settings(data=tmp_path_factory.mktemp("campaigns")))
    profile, stars, rng = shipped_camera("cubestar"), propagate(load_stars(6.0), 2026.5), np.random.default_rng(7)
    for k in range(FRAMES):
        attitude = cam_from_icrs(rng.uniform(0, 6.28), np.arcsin(rng.uniform(-1, 1)), rng.uniform(0, 6.28))
        rendered = render(stars, profile.camera, profile.sensor, attitude, 0.25, rng)
        services.frames.frames._add(
            rendered.pixels,
            source="import",
            name=f"rendered {k}",
            taken=services.frames.frames._now(),
            bits=8,
            exposure_s=0.25,
            profile="cubestar",
            truth=[float(v) for v in rendered.truth.quaternion],
        )
    return services


@pytest.fixture(scope="module")
def client(services: Services, client_of: Callable[..., TestClient]) -> Iterator[TestClient]:
    """Client of an admin on these services."""
    with client_of(services) as client:
        yield client


def finished(client: TestClient, job: dict[str, Any]) -> dict[str, Any]:
    """Return the job after its end."""
    for _ in range(600):
        row: dict[str, Any] = client.get(f"/api/jobs/{job['id']}").json()
        if row["state"] not in ("queued", "running"):
            return row
        time.sleep(0.1)
    raise AssertionError(f"the job did not end: {row}")


def test_reprocessing_keeps_one_result_per_frame_and_resumes(client: TestClient) -> None:
    """A job solves all frames. A second start is rejected because no frame is left; ``again`` repeats the solutions."""
    answer = client.post("/api/campaigns/reprocess", json={"chain": "cubestar"})
    assert answer.status_code == 201, answer.text
    job = finished(client, answer.json())
    assert (job["state"], job["done"], job["total"]) == ("done", FRAMES, FRAMES), job
    assert job["result"]["counts"].get("wrong", 0) == 0
    (row,) = (r for r in client.get("/api/campaigns/chains").json() if r["chain"] == "cubestar")
    assert (row["frames"], row["solved"]) == (FRAMES, job["result"]["counts"]["solved"])
    assert row["median_error_axis_arcsec"] < 60
    low, high = row["solved_interval"]
    assert 0 < low < row["solved"] / FRAMES <= high <= 1
    assert (row["judged"] > 0, row["wrong_most"] < 1) == (True, True)
    second_start = client.post("/api/campaigns/reprocess", json={"chain": "cubestar"})
    assert second_start.status_code == 400
    assert "No frame to run" in second_start.json()["message"]
    again = client.post("/api/campaigns/reprocess", json={"chain": "cubestar", "frame_ids": [1, 2], "again": True})
    assert finished(client, again.json())["done"] == 2


def test_reprocessing_with_changed_constants_is_compared_separately(client: TestClient) -> None:
    """Results with changed constants do not count as results of the chain. The comparison shows them in a separate
    row.
    """
    body = {"chain": "oersted", "frame_ids": [1, 2], "profile": "cubestar", "options": {"min_area_px": "3"}}
    job = finished(client, client.post("/api/campaigns/reprocess", json=body).json())
    assert (job["state"], job["done"]) == ("done", 2), job
    rows = [(r["options"], r["frames"]) for r in client.get("/api/campaigns/chains").json() if r["chain"] == "oersted"]
    assert rows == [("min_area_px=3", 2)]
    assert client.post("/api/campaigns/reprocess", json=body).status_code == 400
    body["options"] = {"no_such": "1"}
    answer = client.post("/api/campaigns/reprocess", json=body)
    assert (answer.status_code, "no such constant" in answer.json()["message"]) == (400, True)


def test_the_report_of_a_chain_explains_its_failures_against_another(client: TestClient) -> None:
    """Counts, plots and reasons agree with the stored results. Every failure names its frame. A chain without results
    is a 404.
    """
    finished(client, client.post("/api/campaigns/reprocess", json={"chain": "aim", "profile": "cubestar"}).json())
    rows = {r["chain"]: r for r in client.get("/api/campaigns/chains").json() if not r["options"]}
    pair = {"chain": "aim", "version": rows["aim"]["version"]}
    answer = client.get("/api/campaigns/chains/report", params=pair).json()
    assert answer["failed"] >= FRAMES - rows["aim"]["solved"]
    assert {f["kind"] for f in answer["failures"]} <= {"no solution", "wrong", "differs"}
    assert all(f["reason"] and 1 <= f["frame_id"] <= FRAMES for f in answer["failures"])
    sections = {s["title"]: s for s in answer["report"]["sections"]}
    table = sections["Against the other result"]["tables"][0]
    assert sum(int(c) for row in table["rows"] for c in row[1:] if c != "–") == FRAMES
    over_time, on_sky = sections["When and where"]["drawings"]
    assert all(v is None or 0 <= v <= 100 for v in over_time["series"][0]["y"])
    assert len(on_sky["series"][0]["x"]) == rows["aim"]["solved"]
    reasons = sections["Why frames were not solved"]["tables"][0]["rows"]
    assert sum(int(row[0]) for row in reasons) == FRAMES - rows["aim"]["solved"]
    against = pair | {"against_chain": "cubestar", "against_version": rows["cubestar"]["version"]}
    assert "against cubestar" in client.get("/api/campaigns/chains/report", params=against).json()["report"]["subtitle"]
    pdf = client.get("/api/campaigns/chains/report.pdf", params=against)
    assert pdf.content.startswith(b"%PDF"), pdf.text
    for unknown in ({"version": "0"}, {"against_chain": "sunsat", "against_version": "0"}):
        assert client.get("/api/campaigns/chains/report", params=pair | unknown).status_code == 404


def test_a_cancelled_job_keeps_complete_results_only(services: Services, monkeypatch: pytest.MonkeyPatch) -> None:
    """A job that is cancelled at its first result keeps the results of the first batch. Before, it reports that it has
    no result yet. The next start runs the other frames.
    """
    monkeypatch.setattr("gss.operations.studies.reprocess.BATCH", 8)
    request = ReprocessRequest(chain="reference")
    tasks = services.studies.reprocessing.tasks(request)
    texts: list[str] = []

    def cancel(done: int, _total: int, text: str) -> None:
        texts.append(text)
        if done:
            raise Cancelled

    with pytest.raises(Cancelled):
        services.studies.reprocessing.work(request, tasks, cancel)
    assert texts[0] == f"starting workers, no result of {len(tasks)} frames yet"
    assert texts[-1].startswith(f"8 of {len(tasks)} frames")
    remaining = services.studies.reprocessing.tasks(request)
    assert 0 < len(remaining) < len(tasks)


def test_a_killed_worker_costs_only_its_batch(services: Services, monkeypatch: pytest.MonkeyPatch) -> None:
    """If all workers are killed, only their batches in progress are rerun, once. Repeated crashes end the job."""
    monkeypatch.setattr("gss.operations.studies.reprocess.BATCH", 1)
    request = ReprocessRequest(chain="far_mst", profile="cubestar")
    tasks = services.studies.reprocessing.tasks(request)

    killed_pids: list[int] = []

    def kill_once(_done: int, _total: int, _text: str) -> None:
        for child in [] if killed_pids else multiprocessing.active_children():
            killed_pids.append(child.pid or 0)
            os.kill(child.pid or 0, signal.SIGKILL)

    assert services.studies.reprocessing.work(request, tasks, kill_once)["frames"] == len(tasks)
    assert killed_pids
    assert services.studies.reprocessing.tasks(request) == []
    for task in tasks:
        assert [s.chain for s in services.frames.frames.detail(task.frame_id).solutions].count("far_mst") == 1

    with (
        pytest.raises(GssError, match="crashed repeatedly"),
        closing(services.studies.executor.in_order(exit_worker, [9])) as results,
    ):
        list(results)


def exit_worker(status: int, _arguments: object) -> None:
    """Work function that ends its worker process."""
    os._exit(status)


def test_workers_and_server_give_the_same_result(client: TestClient, services: Services) -> None:
    """A chain that the server runs on request gives bit-identical results to a job in a worker."""
    server_result = client.post("/api/frames/3/solve", json={"chain": "cubestar"}).json()
    detail = client.get("/api/frames/3").json()
    solutions = [s for s in detail["solutions"] if s["chain"] == "cubestar"]
    assert len(solutions) >= 2
    assert len({str(s["attitude"]) for s in solutions}) == 1
    assert server_result["attitude"] == solutions[0]["attitude"]


@pytest.mark.parametrize(
    "body",
    [{"chain": "no-such"}, {"chain": "cubestar", "frame_ids": [99999]}, {"chain": ""}, {"chain": "cubestar", "x": 1}],
)
def test_invalid_requests_are_rejected(client: TestClient, body: dict[str, Any]) -> None:
    """Requests with an unknown chain, frame or key, or without a name, are rejected and queue no job."""
    before = len(client.get("/api/jobs").json())
    assert client.post("/api/campaigns/reprocess", json=body).status_code in (400, 404, 422)
    assert len(client.get("/api/jobs").json()) == before


def test_experiments_run_as_a_job(client: TestClient) -> None:
    """The list names the experiments, and a job returns tables with the paper's figures. Unknown experiments are
    rejected before anything runs.
    """
    names = [e["name"] for e in client.get("/api/campaigns/experiments").json()]
    assert {"jacobs-5-1", "erlank-3-6"} <= set(names)
    body = {"names": ["erlank-3-6", "jacobs-5-2"], "trials": 200}
    job = finished(client, client.post("/api/campaigns/experiments", json=body).json())
    assert job["state"] == "done", job
    assert [e["name"] for e in job["result"]["experiments"]] == body["names"]
    assert all(e["columns"][1] == "paper" for e in job["result"]["experiments"])
    assert {j["kind"] for j in client.get("/api/jobs?kind=experiments&limit=5").json()} == {"experiments"}
    assert client.get("/api/jobs?kind=experiments").json()[0]["id"] == job["id"]
    assert client.get("/api/jobs?kind=calibration").json() == []
    assert client.post("/api/campaigns/experiments", json={"names": ["x"]}).status_code == 404
    assert client.post("/api/campaigns/experiments", json={"names": ["erlank-3-6"], "trials": 0}).status_code == 422


def test_without_the_package_the_hint_names_it(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """List and run return 409 with the package that contains the experiments. No job is queued."""
    for module in ("validation", "validation.entries", "validation.run"):
        monkeypatch.setitem(sys.modules, module, None)
    before = len(client.get("/api/jobs").json())
    body = {"names": ["erlank-3-6"], "trials": 50}
    for answer in (
        client.get("/api/campaigns/experiments"),
        client.post("/api/campaigns/experiments", json=body),
    ):
        assert answer.status_code == 409
        assert "gss-startracker[validation]" in answer.json()["hint"]
    assert len(client.get("/api/jobs").json()) == before


def test_results_are_exported_as_csv_and_parquet(client: TestClient, services: Services, tmp_path: Path) -> None:
    """Both formats have the same rows, and their values agree with the page. An unknown format is rejected."""
    assert client.post("/api/frames/5/solve", json={"chain": "cubestar"}).status_code == 201
    parquet = pq.read_table(io.BytesIO(client.get("/api/campaigns/solutions?format=parquet&chain=cubestar").content))
    csv_rows = list(csv.DictReader(client.get("/api/campaigns/solutions?chain=cubestar").text.splitlines()))
    rows = parquet.to_pylist()
    assert len(rows) == len(csv_rows) >= 1
    assert [r["solution_id"] for r in rows] == [int(r["solution_id"]) for r in csv_rows]
    detail = client.get(f"/api/frames/{rows[0]['frame_id']}").json()
    solution = next(s for s in detail["solutions"] if s["id"] == rows[0]["solution_id"])
    assert rows[0]["ra_deg"] == pytest.approx(solution["attitude"]["ra_deg"], abs=1e-9)
    assert client.get("/api/campaigns/solutions?format=xlsx").status_code == 422
    out = tmp_path / "all.parquet"
    assert main(["export", "solutions", "--out", str(out), "--data", str(services.base.settings.data)]) == 0
    assert pq.read_table(out).num_rows >= len(rows)


def test_frames_with_missing_pixels_are_counted_without_a_result(client: TestClient, services: Services) -> None:
    """A frame whose pixels are missing gets no result, and its page opens. The job completes and counts this frame."""
    row, before = services.frames.frames.get(1), services.frames.frames.detail(1).solutions[0].id
    tasks = services.studies.reprocessing.tasks(ReprocessRequest(chain="cubestar", frame_ids=[1, 2], again=True))
    tasks_without_pixels = [type(t)(**{**vars(t), "sha256": "0" * 64}) if t.frame_id == row.id else t for t in tasks]
    result = services.studies.reprocessing.work(
        ReprocessRequest(chain="cubestar", frame_ids=[1, 2]), tasks_without_pixels, lambda *_: None
    )
    assert (result["frames"], result["counts"]["not processed"]) == (2, 1)
    assert services.frames.frames.detail(1).solutions[0].id == before
    assert client.get("/api/frames/1").status_code == 200
