"""Dictionaries of the blind solver on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.operations.frames.figure_files import FigureFiles
from gss.pipeline.identify.patterns import PatternLevel, build_level
from gss.pipeline.identify.verify import SkyCatalogue

STARS = load_stars(5.0)
SKY = SkyCatalogue(STARS.hip, STARS.icrs, STARS.v_mag)
RADIUS_RAD = 0.2


def same(a: PatternLevel, b: PatternLevel) -> bool:
    """True if two dictionaries are bitwise equal."""
    return (
        a.bright_count == b.bright_count
        and np.array_equal(a.stars, b.stars)
        and np.array_equal(a.size_rad, b.size_rad)
        and np.array_equal(np.asarray(a.tree.data), np.asarray(b.tree.data))
    )


def test_a_stored_dictionary_equals_the_built_one(tmp_path: Path) -> None:
    """The second process reads the first one's file, bitwise equal."""
    built = build_level(SKY, RADIUS_RAD)
    assert same(FigureFiles(tmp_path).levels(SKY)(RADIUS_RAD), built)
    (path,) = tmp_path.glob("*.npz")
    before = path.stat().st_mtime_ns
    assert same(FigureFiles(tmp_path).levels(SKY)(RADIUS_RAD), built)
    assert path.stat().st_mtime_ns == before


def test_another_sky_has_another_file(tmp_path: Path) -> None:
    """Positions of another epoch, or another size, do not use this file."""
    files = FigureFiles(tmp_path)
    files.levels(SKY)(RADIUS_RAD)
    moved = SkyCatalogue(SKY.hip, np.roll(SKY.icrs, 1, axis=1), SKY.v_mag)
    assert same(files.levels(moved)(RADIUS_RAD), build_level(moved, RADIUS_RAD))
    files.levels(SKY)(RADIUS_RAD * 1.5)
    assert len(list(tmp_path.glob("*.npz"))) == 3


def test_a_damaged_file_is_rebuilt(tmp_path: Path) -> None:
    """A truncated file or one of other content costs only time."""
    files = FigureFiles(tmp_path)
    built = files.levels(SKY)(RADIUS_RAD)
    (path,) = tmp_path.glob("*.npz")
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], b"", b"something else"):
        path.write_bytes(content)
        assert same(files.levels(SKY)(RADIUS_RAD), built)
        assert path.read_bytes() == whole or len(path.read_bytes()) == len(whole)


def test_a_folder_that_cannot_be_written_prevents_no_result(tmp_path: Path) -> None:
    """If a file exists at the folder's path the dictionary is built and not stored."""
    place = tmp_path / "taken"
    place.write_text("a file")
    assert len(FigureFiles(place).levels(SKY)(RADIUS_RAD).stars)
