"""Package files written by the program read back to equal models."""

from __future__ import annotations

import pytest

from gss.domain.errors import BadInput
from gss.instruments.camera_file import CameraFile
from gss.instruments.camera_text import camera_text, instrument_text
from gss.instruments.marked_yaml import parse_yaml
from gss.instruments.package import load_instrument, read_camera_file
from gss.instruments.package_files import InstrumentFile
from gss.instruments.registry import shipped_registry


@pytest.mark.parametrize("name", shipped_registry().names())
def test_written_files_are_read_back(name: str) -> None:
    """Camera and description of every shipped instrument are equal after writing and reading, also with a comment and
    an uncertainty."""
    instrument = shipped_registry().get(name)
    content = instrument.camera.model_dump()
    content["geometry"]["focal_length"]["sigma"] = 1.5e-6
    camera = CameraFile.model_validate(content)
    text = camera_text(camera, ["Made for a test:", "", "  name: with a colon"])
    assert read_camera_file("camera.yaml", text) == camera
    assert text.startswith(b"# Made for a test:\n#\n")
    about = parse_yaml("instrument.yaml", instrument_text(instrument.about)).content
    assert InstrumentFile.model_validate(about) == instrument.about
    load_instrument({**instrument.files, "camera.yaml": text, "instrument.yaml": instrument_text(instrument.about)})


def test_a_negative_uncertainty_is_rejected_with_its_line() -> None:
    """A negative uncertainty is rejected with file, line and field."""
    camera = shipped_registry().get("nos3").camera
    text = camera_text(camera).replace(b'unit: "mm", source', b'unit: "mm", sigma: -1, source', 1)
    with pytest.raises(BadInput, match=r"camera.yaml, line \d+: geometry.focal_length.sigma"):
        read_camera_file("camera.yaml", text)


def test_the_uncertainty_is_part_of_the_listed_numbers() -> None:
    """The list of numbers has the uncertainty of each, and None for a number without one."""
    content = shipped_registry().get("nos3").camera.model_dump()
    content["lens"] = {"model": "brown"} | {
        k: {"value": 0.5, "unit": "1", "sigma": 0.25, "source": "stars"} for k in ("k1", "k2", "p1", "p2")
    }
    numbers = {n.name: n.sigma for n in CameraFile.model_validate(content).numbers()}
    assert (numbers["k1"], numbers["columns"]) == (0.25, None)
