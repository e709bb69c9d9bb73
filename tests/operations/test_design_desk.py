"""Design studies: a camera as input, a record with the source of every figure as output."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gss.catalogue_tools.design import design_report as r
from gss.catalogue_tools.design.camera import DesignCamera
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.operations.catalogues.design import DesignQuestion, answer, document_rows, request_of
from gss.operations.catalogues.design_sheet import design_sheet
from gss.operations.report.html import as_html
from gss.operations.requests import request_from

STARS = load_stars()
ROWS = document_rows((i.profile for i in shipped_registry().all() if i.profile.chain), STARS)
SUNSAT = DesignCamera.from_profile(shipped_camera("sunsat"))
SMALL = r.DesignEffort(3_000, 400, 3e4, 200)


def quick(**changes: Any) -> dict[str, Any]:
    """Return the quick study of Sunsat."""
    return answer(DesignQuestion(profile="sunsat", **changes), SUNSAT, STARS, quick=True, documents=ROWS)


def figure(record: dict[str, Any], key: str) -> Any:
    """Return the figure with this key."""
    return next(f for f in record["figures"] if f["key"] == key)


def test_every_figure_has_unit_source_and_a_finite_number() -> None:
    """The record is JSON without NaN, each figure has its source, and values of papers are listed with ours."""
    record = quick(mag_limit=6.0)
    json.dumps(record, allow_nan=False)
    assert all(f["source"] and f["label"] and f["group"] for f in record["figures"])
    assert all(f["value"] is None or math.isfinite(f["value"]) for f in record["figures"])
    assert len({f["key"] for f in record["figures"]}) == len(record["figures"])
    assert figure(record, "limit_mag")["paper"] == 6.0
    assert figure(record, "saturation_mag")["paper_source"].startswith("Jacobs 1995")
    assert record["changed"] == ["mag_limit"]
    assert sum(record["histogram"]["counts"]) == record["histogram"]["pointings"] == 2000
    marks = next(c for c in record["curves"] if c["key"] == "p_by_limit")["marks"]
    assert [(m["x"], round(m["y"], 3)) for m in marks] == [(6.0, 0.56)]


def test_an_edited_camera_is_listed_before_the_documented_one() -> None:
    """An unchanged camera gives five rows. An edited camera is a sixth row, listed first, with changed figures."""
    assert [c["name"] for c in quick()["cameras"]] == ["aim", "cubestar", "far_mst", "oersted", "sunsat"]
    longer = quick(focal_mm=50.0)
    assert not any(c["marks"] for c in longer["curves"])
    assert len(longer["cameras"]) == 6
    assert longer["cameras"][0]["focal_mm"] == 50.0
    assert figure(longer, "pixel_arcsec")["value"] == pytest.approx(
        figure(quick(), "pixel_arcsec")["value"] / 2, rel=1e-5
    )
    assert figure(longer, "limit_mag")["value"] > figure(quick(), "limit_mag")["value"] + 1


def test_the_full_count_adds_the_lens_trade_and_is_reproducible() -> None:
    """A full count contains every lens, reports its progress, and gives exactly the same result with the same seed."""
    reported: list[float] = []
    request = r.DesignRequest(DesignCamera.from_profile(shipped_camera("sunsat")).edited(mag_limit=6.0))
    first = r.design(request, STARS, SMALL, progress=reported.append)
    repeated = r.design(request, STARS, SMALL)
    assert len(first.trade) == len(r.lens_trade.__globals__["LENS_FOCALS"]) * 3
    assert first.in_view.pointings == 3_000
    assert reported == sorted(reported)
    assert reported[0] >= 0
    assert reported[-1] <= 1
    assert np.array_equal(first.in_view.histogram, repeated.in_view.histogram)
    assert first.accuracy == repeated.accuracy
    other = r.design(replace(request, seed=2), STARS, SMALL)
    assert not np.array_equal(first.in_view.histogram, other.in_view.histogram)
    faster = {row.camera.f_number: row.limit_mag for row in first.trade if row.camera.focal_mm == 25.0}
    assert faster[min(faster)] > faster[max(faster)] + 1


def test_wide_and_deep_cameras_are_counted_with_fewer_pointings() -> None:
    """A wide camera with a faint limit is counted with fewer pointings, within the limit on counted stars."""
    wide = DesignCamera.from_profile(shipped_camera("cubestar")).edited(
        focal_mm=3.0, exposure_s=20.0, f_number=0.5, dark_current_e_s=1.0
    )
    report = r.design(r.DesignRequest(wide), STARS, SMALL)
    assert report.looks < 400
    assert report.in_view.pointings < 3_000
    assert report.in_view.mean * report.in_view.pointings < SMALL.pairs * r.MAX_COUNTED * 1.5


def test_an_orbit_replaces_the_whole_sky() -> None:
    """A study along an orbit states this in the record. A pointing law that follows no orbit is rejected."""
    along = DesignQuestion(profile="sunsat", sky="orbit", inclination_deg=97.4, raan_deg=[0.0, 360.0])
    record = answer(along, SUNSAT, STARS, quick=True, documents=ROWS)
    assert record["sky"] == "along the orbit"
    with pytest.raises(BadInput, match="does not follow an orbit"):
        request_of(along.model_copy(update={"pointing": "inertial"}), SUNSAT)


def test_impossible_designs_are_rejected() -> None:
    """A design that detects no star and a negative spare width are rejected. An impossible baffle is a text in the record."""
    with pytest.raises(BadInput, match="detects no star"):
        quick(exposure_s=0.001, read_noise_e=10_000.0, f_number=32.0)
    with pytest.raises(BadInput, match="spare_mm"):
        request_from(DesignQuestion, {"profile": "sunsat", "spare_mm": -1.0})
    narrow = answer(DesignQuestion(profile="sunsat", exclusion_deg=2.9), SUNSAT, STARS, quick=True, documents=ROWS)
    assert "corner of the field" in narrow["baffle_problem"]
    assert narrow["baffles"] == []
    assert any("saturates" in n for n in quick(exposure_s=60.0, mag_limit=1.0)["notes"])
    assert any("fainter than the radiometry" in n for n in quick(mag_limit=7.0)["notes"])


def test_the_page_contains_figures_drawings_and_no_script() -> None:
    """The page contains every figure and a drawing per curve and baffle, without scripts or external resources."""
    record = quick(focal_mm=35.0)
    page = as_html(design_sheet(record))
    assert page.count("<svg") == len(record["curves"]) + len(record["baffles"])
    assert "focal_mm 35 (was 25)" in page
    assert all(f["label"].split("<")[0] in page for f in record["figures"])
    assert "<script" not in page
    assert "http://www.w3.org" in page
    assert page.count("http") == page.count("http://www.w3.org/2000/svg")
    assert "nan" not in page.lower().replace("nanometre", "")
