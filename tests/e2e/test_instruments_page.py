"""A catalogue manager in a real browser installs an instrument package after correcting it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from gss.instruments.package_source import read_package_files, write_zip
from gss.instruments.registry import SHIPPED


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
