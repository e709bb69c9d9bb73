"""The page *Instruments* in a real browser: a catalogue manager installs a package after correcting it, and an engineer
makes one from photographs of the night sky."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from gss.domain.rotation import matrix_from_quaternion
from gss.instruments.package import load_instrument
from gss.instruments.package_source import read_folder, read_package_files, write_zip
from gss.instruments.registry import SHIPPED

pytestmark = [pytest.mark.browser, pytest.mark.timeout(900)]
JOB_MS = 400_000


@pytest.fixture
def cookie(data_folder: Path, signed_in: Callable[..., dict[str, str]]) -> str:
    """Key of the session of a catalogue manager."""
    return signed_in(data_folder, "catalogue manager", "carl")["Cookie"].split("=", 1)[1]


def package(folder: Path, name: str, old: str = "", new: str = "") -> str:
    """Write a zipped copy of the cubestar package named roof, with one text of its camera file replaced; return its
    path.
    """
    files = dict(read_package_files(SHIPPED / "cubestar"))
    files["instrument.yaml"] = files["instrument.yaml"].replace(b"id: cubestar", b"id: roof")
    files["camera.yaml"] = files["camera.yaml"].replace(old.encode(), new.encode()) if old else files["camera.yaml"]
    path = folder / f"{name}.zip"
    path.write_bytes(write_zip("roof", files))
    return str(path)


def test_a_manager_corrects_installs_and_compares_a_package(page: Page, tmp_path: Path) -> None:
    """The page shows a mistake with its file and line, installs the corrected package, and compares the next
    version.
    """
    page.goto("/instruments")
    file_input = page.get_by_test_id("package-file")
    file_input.set_input_files(package(tmp_path, "broken", "value: 6.28, unit: mm", "value: 6.28, unit: cm"))
    expect(page.get_by_test_id("package-problems")).to_contain_text("camera.yaml, line 8: geometry.focal_length")
    expect(page.get_by_test_id("package-install")).to_have_count(0)
    file_input.set_input_files(package(tmp_path, "first"))
    page.get_by_test_id("package-install").click()
    expect(page.get_by_test_id("instrument-numbers")).to_contain_text("Erlank 2013 §5.4, measured 6.28 mm")
    expect(page.locator("[data-instrument=roof]")).to_contain_text("own")
    file_input.set_input_files(package(tmp_path, "second", "value: 6.28", "value: 6.31"))
    expect(page.get_by_test_id("package-differences")).to_contain_text("6.31")
    page.get_by_test_id("package-install").click()
    page.get_by_test_id("compare-version").click()
    expect(page.get_by_test_id("version-differences")).to_contain_text("value: 6.31")
    expect(page.get_by_test_id("procedure").filter(has_text="First light")).to_be_visible()


@pytest.mark.photographs
def test_photographs_become_an_instrument_that_solves_them(
    page: Page,
    served: Any,
    photographs: Path,
    signed_in: Callable[..., dict[str, str]],
    picture: Callable[[str], None],
) -> None:
    """An engineer uploads three photographs of one camera. The page installs a package whose numbers have uncertainties,
    agree with an independent reference and state the date that she entered. With it, a photograph is solved at its
    reference attitude."""
    key = signed_in(served.folder, "engineer", "erin")["Cookie"].split("=", 1)[1]
    page.context.add_cookies([{"name": "gss_session", "value": key, "url": served.address}])
    images = json.loads((photographs / "truth.json").read_text())["images"]
    names = sorted(name for name in images if name.startswith("esa_tetra3"))
    page.goto("/instruments")
    page.get_by_test_id("new-from-photographs").click()
    page.get_by_test_id("photographs-name").fill("roofcam")
    page.get_by_test_id("photographs-files").set_input_files([photographs / name for name in names])
    expect(page.get_by_test_id("photographs-start")).to_have_text("Calibrate 3 photographs")
    page.get_by_test_id("photographs-date").fill("2019-02-30")
    expect(page.get_by_test_id("photographs-date-problem")).to_be_visible()
    expect(page.get_by_test_id("photographs-start")).to_be_disabled()
    page.get_by_test_id("photographs-date").fill("2019-07-29")
    page.get_by_test_id("photographs-start").click()
    expect(page.get_by_test_id("job")).to_have_attribute("data-state", "done", timeout=JOB_MS)
    expect(page.locator("[data-instrument=roofcam]")).to_contain_text("own")
    expect(page.get_by_test_id("camera-only")).to_be_visible()
    focal = page.get_by_test_id("instrument-numbers").get_by_role("row").filter(has_text=re.compile("^focal length"))
    expect(focal).to_contain_text(re.compile(r"±.*photographs: 3 frames, 2019-07-29"))
    picture("instrument-from-photographs")
    instrument = load_instrument(read_folder(served.folder / "instruments" / "roofcam"))
    measured = next(number for number in instrument.camera.numbers() if number.name == "focal_length")
    pitch_mm = instrument.camera.geometry.pitch_column.value
    assert measured.sigma is not None
    assert abs(measured.values[0] / pitch_mm - images[names[0]]["focal_px"]) < 3 * measured.sigma / pitch_mm

    frame = next(f for f in served.ask("GET", "/frames")["frames"] if f["name"].startswith(names[0]))
    page.goto(f"/frames/{frame['id']}")
    page.get_by_test_id("open-run-chain").click()
    form = page.get_by_test_id("run-chain-form")
    form.get_by_label("Profile").select_option("roofcam")
    page.get_by_test_id("run-chain").click()
    solved = served.until(f"/frames/{frame['id']}", lambda f: _with_camera(f, "roofcam"), 300)
    expect(page.get_by_test_id("chain-row").filter(has_text="reference").first).to_contain_text(
        re.compile("solved|correct")
    )
    picture("photograph-solved")
    cam_from_icrs = matrix_from_quaternion(np.array(solved["attitude"]["quaternion"]))
    centre = instrument.profile.camera.unproject(np.array([[511.5, 383.5]]))[0] @ cam_from_icrs
    error_arcsec = np.degrees(np.linalg.norm(centre - np.array(images[names[0]]["R_icrs_to_cam"])[2])) * 3600
    assert error_arcsec < images[names[0]]["suggested_tolerance_arcsec"]


def _with_camera(frame: dict[str, Any], camera: str) -> Any:
    """Return the solution of a frame with a camera; None if there is none."""
    return next((s for s in frame["solutions"] if s["camera_name"] == camera and s["attitude"]), None)
