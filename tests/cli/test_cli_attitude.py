"""``gss attitude``: export of the attitudes of stored frames as CCSDS messages, and comparison with another system."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from gss.cli import main
from gss.domain.frames import cam_from_icrs
from gss.domain.rotation import quaternion_from_matrix, quaternion_inverse, quaternion_product, turned
from gss.orbit.attitude import AttitudeHistory
from gss.orbit.read_attitude import read_attitude
from gss.orbit.write_attitude import aem_of
from gss.settings import Settings
from gss.store import frames as store
from gss.store.engine import Database, open_engine
from gss.store.migration import migrate
from gss.store.models import Frame, Solution

T0 = datetime(2026, 12, 1, 18, tzinfo=UTC)
BODY_FROM_CAM = quaternion_from_matrix(cam_from_icrs(1.0, 0.3, 2.0))
OURS = np.array([quaternion_from_matrix(cam_from_icrs(*np.radians([80.0 + k, -30.0, 10.0]))) for k in range(6)])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Data folder with six solved frames ten seconds apart, of which two have the same time, and one unsolved frame."""
    url = Settings(data=tmp_path).database_url
    migrate(url)
    database = Database(open_engine(url))
    times = [0, 10, 20, 30, 40, 40]
    with database.unit_of_work() as session:
        for k, seconds in enumerate([*times, 50]):
            at = T0 + timedelta(seconds=seconds)
            frame = Frame(
                number=k,
                source="device",
                name="",
                taken=at,
                received=at,
                columns=2,
                rows=2,
                bits=8,
                dtype="uint8",
                sha256="0",
            )
            store.add(session, frame)
            solved = k < len(OURS)
            solution = Solution(
                frame_id=frame.id,
                origin="ground",
                chain="reference",
                version="1",
                created=at,
                outcome="solved" if solved else "none",
                quaternion=OURS[k].tolist() if solved else None,
                sigma_rad=[1e-5, 8e-5] if k else None,
                operational=True,
            )
            store.add_solution(session, solution)
    database.close()
    return tmp_path


SPAN = ["--from", "2026-12-01T18:00:00Z", "--to", "2026-12-01T19:00:00Z"]


def test_attitudes_of_frames_are_exported_as_aem_and_acm(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The export has one attitude for each time, with the name of the unit, and known variances. An empty span is an
    error.
    """
    out = folder / "night.aem"
    assert main(["attitude", "export", *SPAN, "--out", str(out), "--data", str(folder)]) == 0
    exported = read_attitude(out.read_text())
    assert exported.object_name == "cubestar"
    assert np.allclose(exported.quaternions, OURS[:5], atol=1e-9)
    assert main(["attitude", "export", *SPAN, "--format", "acm", "--data", str(folder)]) == 0
    text = capsys.readouterr().out
    assert len(text.split("COV_TYPE = ANGLE\n")[1].splitlines()) == 4 + 1
    assert main(["attitude", "export", "--from", "2027-01-01", "--to", "2027-01-02", "--data", str(folder)]) == 2
    assert "no attitude in this time" in capsys.readouterr().err
    assert main(["attitude", "export", *SPAN, "--origin", "on board", "--data", str(folder)]) == 2


def test_the_mounting_and_errors_against_the_attitude_control_are_found(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The comparison gives the mounting and the residuals of each frame.

    Of four body attitudes, one is rotated by 1e-3 rad about x. The mean rotation is the mounting.
    """
    body = quaternion_product(BODY_FROM_CAM, OURS[:4])
    body[3] = quaternion_product(BODY_FROM_CAM, turned(OURS[3], np.array([1e-3, 0, 0])))
    times_s = T0.timestamp() + 10.0 * np.arange(4)
    history = AttitudeHistory("ZA-1", "SC_BODY_1", times_s, body, np.full((4, 3), np.nan))
    file = folder / "adcs.aem"
    file.write_text("".join(aem_of(history, T0)))
    assert main(["attitude", "compare", str(file), "--json", "--data", str(folder)]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["object_name"], result["frame"], result["frames"]) == ("ZA-1", "SC_BODY_1", 4)
    residuals_rad = np.degrees([frame["residual_arcsec"] for frame in result["compared"]]) * np.pi / 180 / 206265
    assert residuals_rad[:, 0] == pytest.approx([2.5e-4, 2.5e-4, 2.5e-4, -7.5e-4], rel=1e-3)
    mean = np.array(result["cam_from_frame"])
    assert abs(mean @ quaternion_inverse(BODY_FROM_CAM)) > 1 - 1e-7
    assert main(["attitude", "compare", str(file), "--data", str(folder)]) == 0
    assert "4 frames compared" in capsys.readouterr().out
    file.write_text("CCSDS_AEM_VERS = 1.0\n")
    assert main(["attitude", "compare", str(file), "--data", str(folder)]) == 2
