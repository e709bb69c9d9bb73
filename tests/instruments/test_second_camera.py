"""A second camera needs only a package and no code."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.cli import main
from gss.device.simulator.factory import burn_golden
from gss.device.simulator.memory import Memory
from gss.device.simulator.options import add_arguments, instrument_of
from gss.domain.frames import cam_from_icrs
from gss.domain.results import Outcome
from gss.instruments.golden import build_golden
from gss.instruments.registry import Registry
from gss.operations.frames.solve import Solver, SolveRequest
from gss.pipeline.render import render


def test_a_camera_is_added_by_its_package_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A copy of cubestar with a focal length of 9 mm is checked, added, listed and simulated, and its frame is solved."""
    data = tmp_path / "data"
    (data / "instruments").mkdir(parents=True)
    new = ["instrument", "new", "longer", "--from", "cubestar", "--into", str(tmp_path), "--title", "CubeStar: 9 mm"]
    assert main(new) == 0
    file = tmp_path / "longer" / "camera.yaml"
    file.write_text(file.read_text("utf-8").replace("value: 6.28", "value: 9.0"), "utf-8")
    assert main(["instrument", "check", str(tmp_path / "longer")]) == 0
    assert main(["instrument", "add", str(tmp_path / "longer"), "--data", str(data)]) == 0
    assert main(["instrument", "list", "--data", str(data)]) == 0
    listed = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("longer "))
    assert listed.endswith("CubeStar: 9 mm")
    assert main(["instrument", "diff", "cubestar", "longer", "--data", str(data)]) == 1
    assert "+  focal_length: {value: 9.0" in capsys.readouterr().out

    registry = Registry(data / "instruments")
    camera_profile = registry.camera("longer")
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    simulated = instrument_of(parser.parse_args(["--instrument", str(registry.folder("longer"))]))
    assert simulated.version == registry.get("longer").version
    memory = Memory.in_ram()
    burn_golden(memory, simulated.profile, build_golden(simulated.profile, memory.bank_bytes))
    assert memory.record.banks["golden"].profile == "longer"

    stars = propagate(load_stars(6.0), 2026.5)
    pose = cam_from_icrs(1.4, 0.1, 0.3)
    frame = render(stars, camera_profile.camera, camera_profile.sensor, pose, 0.25, np.random.default_rng(5))
    result = Solver(registry.camera, epoch_jyear=2026.5).solve(frame.pixels, SolveRequest(profile="longer"))
    assert result.outcome is Outcome.SOLVED
    assert result.attitude is not None
    assert np.allclose(result.attitude.cam_from_icrs, pose, atol=2e-3)
