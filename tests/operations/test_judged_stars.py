"""Frames with a known truth are scored with the stars at their current positions."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gss.catalogue_tools.envelope.orbits import jyear_of
from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.results import Attitude, Centroids, Matches, Outcome, SolveResult
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix
from gss.instruments.registry import shipped_camera
from gss.operations.frames.scoring import truth_on
from gss.operations.frames.solution_rows import solution_values
from gss.settings import Settings
from gss.wiring.build import build

CAMERA = shipped_camera("cubestar").camera
FAST_HIP = 104214
"""61 Cygni A: 5.3″ per year, or 1.5 px of this camera since the catalogue's epoch."""


def attitude_after_star_entered(old: Any, new: Any) -> np.ndarray:
    """Return cam_from_icrs (3, 3) of a camera in which the star moved across the first column by proper motion."""
    place = CAMERA.unproject(np.array([[0.3, CAMERA.rows / 2], [0.4, CAMERA.rows / 2]]))
    inwards = np.cross(np.cross(place[0], place[1] - place[0]), place[0])
    across = np.cross(np.cross(new, new - old), new)
    in_cam = np.array([v / np.linalg.norm(v) for v in (place[0], inwards, np.cross(place[0], inwards))])
    in_icrs = np.array([v / np.linalg.norm(v) for v in (new, across, np.cross(new, across))])
    return np.asarray(in_cam.T @ in_icrs)


def perfect(cam_from_icrs: np.ndarray, stars: Any) -> SolveResult:
    """Return the result of an error-free chain for the stars of a frame."""
    quaternion = quaternion_from_matrix(cam_from_icrs)
    truth = truth_on(CAMERA, quaternion, stars.brighter_than(6.0))
    n, flux = len(truth.hip), np.ones(len(truth.hip))
    centroids = Centroids(truth.pixels[:, 0], truth.pixels[:, 1], flux, flux, np.ones(n, np.int32), flux)
    matches = Matches(np.arange(n, dtype=np.int32), truth.hip, flux, np.zeros((n, 2)))
    attitude = Attitude(quaternion, np.eye(3) * 1e-10)
    return SolveResult("reference", Outcome.SOLVED, "", CAMERA, (), centroids, matches, attitude, 0.0)


def test_a_star_that_entered_the_frame_by_proper_motion_is_not_a_false_match(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The server scores a match with such a star as correct. With positions at the catalogue's epoch it would be wrong."""
    then = load_stars()
    now = propagate(then, jyear_of(datetime.now(UTC)))
    row = int(np.flatnonzero(then.hip == FAST_HIP)[0])
    cam_from_icrs = attitude_after_star_entered(then.icrs[row], now.icrs[row])
    result = perfect(cam_from_icrs, now)
    quaternion = [float(v) for v in quaternion_from_matrix(cam_from_icrs)]
    assert FAST_HIP in result.matches.hip
    assert not CAMERA.contains(CAMERA.project(matrix_from_quaternion(np.array(quaternion)) @ then.icrs[row])[None])[0]
    assert solution_values(result, then, shipped_camera("cubestar"), quaternion)["verdict"] == "wrong"

    services = build(Settings(data=tmp_path))
    monkeypatch.setattr(services.frames.frames.queue, "add", lambda *_: None)
    pixels = np.zeros((CAMERA.rows, CAMERA.columns), np.uint8)
    facts = {"taken": datetime.now(UTC), "bits": 8, "profile": "cubestar", "number": 1, "truth": quaternion}
    frame = services.frames.frames.add_from_device(pixels, facts)
    assert services.frames.frames.keep_replay(frame, result, "equal").verdict == "correct"
    services.base.database.close()
