"""Dictionaries of the blind solver on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.operations.frames.figure_files import FigureFiles
from gss.pipeline.identify.patterns import Level, build_level
from gss.pipeline.identify.verify import Sky

STARS = load_stars(5.0)
SKY = Sky(STARS.hip, STARS.icrs, STARS.v_mag)
RADIUS_RAD = 0.2


def same(a: Level, b: Level) -> bool:
    """Whether two dictionaries hold the same, bit for bit."""
    return (
        a.bright_count == b.bright_count
        and np.array_equal(a.stars, b.stars)
        and np.array_equal(a.size_rad, b.size_rad)
        and np.array_equal(np.asarray(a.tree.data), np.asarray(b.tree.data))
    )


def test_a_kept_dictionary_is_the_built_one(tmp_path: Path) -> None:
    """The second process reads what the first one wrote, and it is the same to the bit."""
    built = build_level(SKY, RADIUS_RAD)
    assert same(FigureFiles(tmp_path).levels(SKY)(RADIUS_RAD), built)
    (path,) = tmp_path.glob("*.npz")
    before = path.stat().st_mtime_ns
    assert same(FigureFiles(tmp_path).levels(SKY)(RADIUS_RAD), built)
    assert path.stat().st_mtime_ns == before


def test_another_sky_has_another_file(tmp_path: Path) -> None:
    """Positions of another epoch, or another size, never meet the wrong file."""
    files = FigureFiles(tmp_path)
    files.levels(SKY)(RADIUS_RAD)
    moved = Sky(SKY.hip, np.roll(SKY.icrs, 1, axis=1), SKY.v_mag)
    assert same(files.levels(moved)(RADIUS_RAD), build_level(moved, RADIUS_RAD))
    files.levels(SKY)(RADIUS_RAD * 1.5)
    assert len(list(tmp_path.glob("*.npz"))) == 3


def test_a_damaged_file_is_built_anew(tmp_path: Path) -> None:
    """Half a file, or one of something else, costs time and nothing more."""
    files = FigureFiles(tmp_path)
    built = files.levels(SKY)(RADIUS_RAD)
    (path,) = tmp_path.glob("*.npz")
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], b"", b"something else"):
        path.write_bytes(content)
        assert same(files.levels(SKY)(RADIUS_RAD), built)
        assert path.read_bytes() == whole or len(path.read_bytes()) == len(whole)


def test_a_folder_that_cannot_be_written_costs_no_answer(tmp_path: Path) -> None:
    """Where a file stands in the folder's place the dictionary is built and simply not kept."""
    place = tmp_path / "taken"
    place.write_text("a file")
    assert len(FigureFiles(place).levels(SKY)(RADIUS_RAD).stars)
