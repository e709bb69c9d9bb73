"""Lists of measured stars over HTTP: upload, job, results, exports, and files that are rejected."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient
from scipy.spatial.transform import Rotation

from gss.domain.errors import StoreDown
from gss.operations.studies.list_runs import ListRunRequest
from gss.settings import Settings
from gss.wiring.build import build
from tools.bench_scenes import CAMERAS, CentroidList, Disturbance, star_lists, visible_stars

OPTICS = CAMERAS[0]


def scenes() -> list[CentroidList]:
    """Return star lists of CubeStar's camera without distortion, generated independently of the product code."""
    return star_lists(visible_stars(OPTICS), OPTICS, 3, Disturbance(3), 31)


def lists_npz(scenes: list[CentroidList]) -> bytes:
    """Return an NPZ file with these lists and an empty list."""
    pixels = np.concatenate([s.offset_px for s in scenes]) + np.array([OPTICS.columns - 1, OPTICS.rows - 1]) / 2
    first = np.concatenate([[0], np.cumsum([len(s.offset_px) for s in scenes])])
    flux = 10 ** (-0.4 * np.concatenate([s.magnitude for s in scenes]))
    file = io.BytesIO()
    np.savez(file, col_px=pixels[:, 0], row_px=pixels[:, 1], flux=flux, first=np.append(first, first[-1]))
    return file.getvalue()


def test_lists_are_solved_as_a_job(client: TestClient) -> None:
    """The job counts the lists. Results are paged in the order of the file and have attitude, matches, false-match
    probability and time. An empty list has a reason. JSON and CSV contain the same values.
    """
    truth = scenes()
    fields = {"camera": "cubestar", "no_distortion": "true"}
    started = client.post("/api/lists", files={"file": ("night.npz", lists_npz(truth))}, data=fields)
    assert started.status_code == 202, started.text
    run, job = started.json()["run"], started.json()["job"]
    assert (run["lists"], run["solved"]) == (4, None)
    assert client.get(f"/api/lists/{run['id']}/results").status_code == 404
    end = time.monotonic() + 240
    while (job := client.get(f"/api/jobs/{job['id']}").json())["state"] in ("queued", "running"):
        assert time.monotonic() < end, job
        time.sleep(0.3)
    assert (job["state"], job["total"], job["result"]["solved"]) == ("done", 4, 3), job
    assert client.get("/api/lists").json()[0]["solved"] == 3
    page = client.get(f"/api/lists/{run['id']}/results", params={"limit": 2, "offset": 2}).json()
    assert (page["total"], [r["list"] for r in page["results"]]) == (4, [2, 3])
    assert (page["results"][1]["outcome"], page["results"][1]["ra_deg"]) == ("none", None)
    assert "0 stars" in page["results"][1]["reason"]
    document = client.get(f"/api/lists/{run['id']}/export").json()
    assert (document["name"], document["camera"]) == ("night.npz", "cubestar")
    for scene, result in zip(truth, document["results"], strict=False):
        off = Rotation.from_quat(result["quaternion"]).as_matrix() @ scene.cam_from_icrs.T
        assert np.degrees(np.arccos(min(1.0, (np.trace(off) - 1) / 2))) < 0.1
        boresight = scene.cam_from_icrs[2]
        assert result["dec_deg"] == pytest.approx(np.degrees(np.arcsin(boresight[2])), abs=0.05)
        assert result["matched"] >= 4
        assert result["false_match_probability"] <= 1e-6
        assert result["ms"] > 0
    rows = list(
        csv.DictReader(client.get(f"/api/lists/{run['id']}/export", params={"format": "csv"}).text.splitlines())
    )
    assert [float(r["qw"]) for r in rows[:3]] == [r["quaternion"][3] for r in document["results"][:3]]
    assert rows[3]["qw"] == ""


@pytest.mark.parametrize(
    ("content", "fields", "status", "words"),
    [
        (b"list,col_px,row_px,flux\n0,1,2,3\n0,1,x,3\n", {}, 400, "Line 3 of lists.csv does not have four numbers"),
        (b"list,col_px,row_px,flux\n0,1,2,-3\n", {}, 400, "flux in line 2 of lists.csv is invalid"),
        (b"", {}, 400, "lists.csv is empty"),
        (b"list,col_px,row_px,flux\n0,1,2,3\n", {"camera": "nosuch"}, 404, "Unknown instrument"),
        (b"list,col_px,row_px,flux\n0,1,2,3\n", {"sigma_px": "0"}, 400, "sigma_px is out of range"),
    ],
)
def test_bad_input_is_refused(
    client: TestClient, content: bytes, fields: dict[str, str], status: int, words: str
) -> None:
    """The response states the reason, for invalid files with file and line. No job is started."""
    before = len(client.get("/api/jobs").json())
    files = {"file": ("lists.csv", content)}
    answer = client.post("/api/lists", files=files, data={"camera": "cubestar"} | fields)
    assert answer.status_code == status, answer.text
    assert words in answer.json()["message"]
    assert len(client.get("/api/jobs").json()) == before


def test_a_run_is_deleted_with_its_blobs(tmp_path: Path, client_of: Callable[..., TestClient]) -> None:
    """Deletion keeps content that another run uses and otherwise leaves no file. A viewer may not delete."""
    services = build(Settings(data=tmp_path))
    runs, spec = services.studies.list_runs, ListRunRequest(camera="cubestar")
    data = b"list,col_px,row_px,flux\n0,1,2,3\n"
    first, _ = runs.start(data, "a.csv", spec, user="ann")
    second, _ = runs.start(data, "b.csv", spec, user="ann")
    with client_of(services) as admin:
        viewer = client_of(services, "vic", "viewer")
        assert viewer.delete(f"/api/lists/{first.id}").status_code == 403
        assert admin.delete(f"/api/lists/{first.id}").status_code == 204
        assert services.base.blobs.exists(first.sha256)
        assert admin.delete(f"/api/lists/{second.id}").status_code == 204
        assert not services.base.blobs.exists(second.sha256)
        assert admin.get("/api/lists").json() == []
        assert admin.delete(f"/api/lists/{first.id}").status_code == 404
        services.base.jobs.finish()
        assert list(services.base.blobs.keys()) == []  # whether the jobs ended before or after the deletion


def test_a_full_disk_refuses_lists_before_they_are_stored(tmp_path: Path) -> None:
    """On a full disk the run is rejected before a blob or a row is stored."""
    services = build(Settings(data=tmp_path, disk_stop_mb=10**9))
    with pytest.raises(StoreDown, match="no room"):
        services.studies.list_runs.start(
            b"list,col_px,row_px,flux\n0,1,2,3\n", "a.csv", ListRunRequest(camera="cubestar"), user="ann"
        )
    assert services.studies.list_runs.newest(5) == []
    assert not any(path.is_file() for path in (tmp_path / "blobs").rglob("*"))
    services.stop()
