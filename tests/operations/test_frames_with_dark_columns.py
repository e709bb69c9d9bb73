"""Frames of a detector with dark columns, from the device and from files, to the chain."""

from __future__ import annotations

import io
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import shipped_camera
from gss.operations.frames.solve import SolveRequest
from gss.pipeline.render import Rendered, render
from gss.settings import Settings
from gss.store.models import Frame
from gss.wiring.build import build
from gss.wiring.services import Services

PROFILE = shipped_camera("sunsat")
POINTING = cam_from_icrs(*np.radians([84.0, -2.0, 30.0]))


@pytest.fixture
def services(tmp_path: Path) -> Iterator[Services]:
    services = build(Settings(data=tmp_path))
    yield services
    services.frames.frames.stop()
    services.base.parsing.stop()
    services.base.database.close()


@pytest.fixture(scope="module")
def rendered() -> Rendered:
    stars, rng = propagate(load_stars(7.5), 2026.5), np.random.default_rng(5)
    return render(stars, PROFILE.camera, PROFILE.sensor, POINTING, 0.5, rng, defects=PROFILE.defects)


def solved_with(services: Services, frame: Frame, chain: str) -> tuple[str, str]:
    """Return outcome and notes of a chain."""
    row = services.frames.frames.preview(frame.id, SolveRequest(chain=chain, profile="sunsat"))
    return row.outcome, " ".join(row.notes)


@pytest.mark.parametrize("source", ["device", "file"])
def test_complete_rows_are_stored_and_the_chain_uses_the_dark_columns(
    services: Services, rendered: Rendered, source: str
) -> None:
    """The complete rows are stored. Pages get the light-sensitive pixels, Sunsat's chain uses the dark columns, and the
    reference chain works without them."""
    frames, picture = services.frames.frames, PROFILE.sensor.dark_columns.join(rendered.pixels, rendered.dark)
    if source == "device":
        facts = {"taken": datetime.now(UTC), "bits": 8, "profile": "sunsat", "number": 1}
        frame = frames.add_from_device(picture, facts)
    else:
        out = io.BytesIO()
        Image.fromarray(picture).save(out, "png")
        frame = frames.add_from_file(out.getvalue(), "a.png", "sunsat", user="test")
    assert (frame.columns, frame.rows, frame.parameters["dark_columns"]) == (752, 582, [3, 40])
    assert (frames.pixels(frame) == rendered.pixels).all()
    assert (frames.picture(frame) == picture).all()
    outcome, notes = solved_with(services, frame, "sunsat")
    assert outcome == "solved"
    assert "from 43 dark columns" in notes
    assert solved_with(services, frame, "reference")[0] == "solved"


def test_a_frame_without_dark_columns_is_still_solved(services: Services, rendered: Rendered) -> None:
    """Light-sensitive pixels alone, as stored by earlier versions, are solved with the sky level of each row."""
    facts = {"taken": datetime.now(UTC), "bits": 8, "profile": "sunsat", "number": 1}
    frame = services.frames.frames.add_from_device(rendered.pixels, facts)
    assert "dark_columns" not in frame.parameters
    outcome, notes = solved_with(services, frame, "sunsat")
    assert outcome == "solved"
    assert "no dark columns" in notes
