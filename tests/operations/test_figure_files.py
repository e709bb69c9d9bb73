"""Pattern dictionaries of the blind solver on disk."""

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


def is_equal(a: PatternLevel, b: PatternLevel) -> bool:
    """True if two dictionaries are bitwise equal."""
    return (
        a.bright_count == b.bright_count
        and np.array_equal(a.stars, b.stars)
        and np.array_equal(a.size_rad, b.size_rad)
        and np.array_equal(np.asarray(a.tree.data), np.asarray(b.tree.data))
    )


def test_a_stored_dictionary_equals_the_built_one(tmp_path: Path) -> None:
    """A second reader of the folder loads the stored dictionary, which is bitwise equal to a newly built one."""
    built = build_level(SKY, RADIUS_RAD)
    assert is_equal(FigureFiles(tmp_path).levels(SKY)(RADIUS_RAD), built)
    (path,) = tmp_path.glob("*.npz")
    before = path.stat().st_mtime_ns
    assert is_equal(FigureFiles(tmp_path).levels(SKY)(RADIUS_RAD), built)
    assert path.stat().st_mtime_ns == before


def test_another_sky_has_another_file(tmp_path: Path) -> None:
    """Other star positions and another size have separate files."""
    files = FigureFiles(tmp_path)
    files.levels(SKY)(RADIUS_RAD)
    moved = SkyCatalogue(SKY.hip, np.roll(SKY.icrs, 1, axis=1), SKY.v_mag)
    assert is_equal(files.levels(moved)(RADIUS_RAD), build_level(moved, RADIUS_RAD))
    files.levels(SKY)(RADIUS_RAD * 1.5)
    assert len(list(tmp_path.glob("*.npz"))) == 3


def test_a_damaged_file_is_rebuilt(tmp_path: Path) -> None:
    """A truncated file or one with other content is rebuilt."""
    files = FigureFiles(tmp_path)
    built = files.levels(SKY)(RADIUS_RAD)
    (path,) = tmp_path.glob("*.npz")
    valid = path.read_bytes()
    for content in (valid[: len(valid) // 2], b"", b"something else"):
        path.write_bytes(content)
        assert is_equal(files.levels(SKY)(RADIUS_RAD), built)
        assert path.read_bytes() == valid or len(path.read_bytes()) == len(valid)


def test_a_dictionary_is_built_if_the_folder_cannot_be_written(tmp_path: Path) -> None:
    """If the folder cannot be created, the dictionary is built and not stored."""
    file_path = tmp_path / "taken"
    file_path.write_text("a file")
    assert len(FigureFiles(file_path).levels(SKY)(RADIUS_RAD).stars)
