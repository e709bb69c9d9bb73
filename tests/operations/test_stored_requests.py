"""Requests that version 0.4 stored with its jobs can still be read."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import pytest

from gss.domain.errors import BadInput
from gss.operations.requests import as_stored
from gss.settings import Settings
from gss.store import jobs as store
from gss.store.models import Job
from gss.wiring.build import build

STORED = {
    "catalogue": {
        "asked": {"name": "old", "days": 14.0, "raan_deg": [0.0, 360.0], "corrections": {"proper_motion": True}},
        "user": "ann",
        "at": "2026-10-01T12:00:00+00:00",
        "bank_bytes": 65536,
    },
    "design": {"profile": "sunsat", "focal_mm": 60.0, "sky": "orbit", "raan_deg": [0.0, 360.0], "pointings": 5000},
    "experiments": {"names": ["sunsat-1"], "trials": 10, "seed": 1},
    "reprocess": {
        "chain": "reference",
        "version": "0.4.0",
        "frames": 2,
        "again": False,
        "user": "ann",
        "frame_ids": [],
        "profile": None,
        "filters": {"source": "device", "contact_id": 3},
        "up_to": 7,
        "epoch_jyear": 2026.8,
    },
    "calibration": {
        "type": "BenchCalibration",
        "wanted": {
            "kind": "bench-checkerboard",
            "profile": "cubestar",
            "rows": [],
            "frame_ids": [1, 2],
            "positions": [],
            "options": {"corners": [9, 6], "square_mm": 25.0},
        },
        "name": "",
        "note": "",
        "user": "ann",
    },
    "analysis": {
        "type": "FrameAnalysis",
        "wanted": {
            "kind": "slew",
            "profile": "cubestar",
            "frame_ids": [1, 2],
            "chain": "reference",
            "commanded_rad_s": 0.001,
            "other_profile": "",
            "other_ids": [],
        },
        "title": "night",
        "user": "ann",
    },
    "backup": {"keep": 3, "user": "ann"},
    "retention": {
        "policy": {"frames_days": 30, "backups_keep": 2},
        "user": "ann",
        "confirmed": {
            "at": "2026-10-01T12:00:00+00:00",
            "frames": 1,
            "frames_bytes": 2,
            "packets": 3,
            "to_thin": 0,
            "events": 4,
        },
    },
    "check-store": {"user": "ann"},
}


@pytest.fixture(scope="module")
def services(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Services that are connected but not started."""
    built = build(Settings(data=tmp_path_factory.mktemp("data")))
    yield built
    built.stop()


@pytest.mark.parametrize("name", sorted(STORED))
def test_a_stored_request_of_0_4_is_read_and_stored_again_without_loss(services: Any, name: str) -> None:
    """Reading, storing with this version and reading again gives the same request."""
    kind = services.base.jobs._kinds[name]
    request = kind.read(STORED[name])
    assert request.user == STORED[name].get("user", "")
    assert kind.read(as_stored(request)) == request


def test_the_values_of_a_stored_request_of_0_4_are_kept(services: Any) -> None:
    """Angles, filters, options and times of requests of version 0.4 are read with their values."""
    kinds = services.base.jobs._kinds
    catalogue = kinds["catalogue"].read(STORED["catalogue"])
    assert (catalogue.asked.name, catalogue.bank_bytes) == ("old", 65536)
    assert catalogue.at == datetime(2026, 10, 1, 12, tzinfo=UTC)
    assert kinds["design"].read(STORED["design"]).asked.changes == {"focal_mm": 60.0}
    reprocess = kinds["reprocess"].read(STORED["reprocess"])
    assert (reprocess.asked.contact, reprocess.asked.source, reprocess.up_to) == (3, "device", 7)
    calibration = kinds["calibration"].read(STORED["calibration"]).wanted
    assert (type(calibration).__name__, calibration.square_mm, calibration.corners) == (
        "BenchCheckerboard",
        25.0,
        [9, 6],
    )
    analysis = kinds["analysis"].read(STORED["analysis"]).wanted
    assert (analysis.commanded_rad_s, analysis.title) == (pytest.approx(0.001), "night")
    stars = {"frame_ids": [3], "profile": "", "models": [], "photometry": True, "psf": False, "fov_rad": 0.5}
    named = {"wanted": stars | {"prior_ids": [1]}, "name": "roof", "note": "", "user": "ann"}
    older = kinds["calibration"].read(named).wanted
    assert (older.fov_rad, older.frames, older.prior_ids, older.name) == (pytest.approx(0.5), [3], [1], "roof")
    contact = {"wanted": {"contact_id": 4}, "title": "", "user": "ann"}
    assert kinds["analysis"].read(contact).wanted.contact == 4
    assert kinds["retention"].read(STORED["retention"]).confirmed.events == 4


def test_a_request_that_cannot_be_read_ends_its_job_with_the_reason(services: Any) -> None:
    """A job whose stored request has an unknown field fails with the reason and cannot be started again."""
    stored = {"asked": {"no_such_field": 1}, "user": "ann", "at": "2026-10-01T12:00:00Z"}
    with services.base.database.unit_of_work() as session:
        job = store.add(
            session, Job(kind="catalogue", title="t", state="queued", created=datetime.now(UTC), request=stored)
        )
        job.attempts = 0
    services.base.jobs.start()
    failed_job = services.base.jobs.get(job.id)
    assert (failed_job.state, "stored by another version" in failed_job.text) == ("failed", True)
    with pytest.raises(BadInput, match="another version"):
        services.base.jobs.again(job.id, user="bob")
