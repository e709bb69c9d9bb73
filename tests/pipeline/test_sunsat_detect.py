"""Sunsat's region growing: dark rows, limits, edge rule, shape test, centre of gravity, magnitude."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.onboard import Commanded
from gss.pipeline.chains.sunsat import find_in_frame
from gss.pipeline.chains.sunsat_detect import (
    Streak,
    brightness_dn,
    dark_rows_dn,
    find_stars,
    gravity_centroids,
    magnitudes,
    moved,
    shapes,
)
from gss.pipeline.chains.sunsat_onboard import SunsatChain
from gss.pipeline.chains.sunsat_parameters import SOURCES, SunsatParameters, default_parameters
from gss.pipeline.regions import Blobs, find_blobs
from gss.pipeline.render import FalseStar, render

PROFILE = shipped_camera("sunsat")
CAMERA, SENSOR = PROFILE.camera, PROFILE.sensor
PARAMETERS = default_parameters(PROFILE)
NO_STARS = load_stars(3.0).take(np.zeros(0, np.intp))


def test_every_constant_has_a_source() -> None:
    """Each field of the parameters, or the name under which the document has it, is in SOURCES."""
    renamed = {"uncertain_reach_mm": "uncertain_mm2", "residual_tolerances": "residual_tolerance_rad"}
    unsourced = {"focal_mm", "exposure_s", "max_small_regions"}
    names = {renamed.get(f, f) for f in SunsatParameters.__dataclass_fields__} - unsourced
    assert names <= set(SOURCES)


@pytest.mark.parametrize(
    "change",
    [{"threshold_dn": 0.0}, {"min_area_px": 400}, {"matcher": "luck"}, {"acceptance": "hope"}, {"min_group": 2}],
)
def test_invalid_parameters_are_rejected(change: dict[str, float]) -> None:
    """Thresholds, areas and names that make no sense are bad input."""
    with pytest.raises(BadInput):
        replace(PARAMETERS, **change)


def test_commands_go_into_the_parameters() -> None:
    """Threshold, areas and, when assisted, the hint's radius are what the operator set."""
    commanded = Commanded(threshold_dn=9, min_area_px=4, max_area_px=50, hint_radius_rad=0.1)
    p = SunsatChain().parameters(PROFILE, 0.25, commanded, Mode.ASSISTED)
    assert (p.threshold_dn, p.min_area_px, p.max_area_px, p.hint_error_rad, p.exposure_s) == (9, 4, 50, 0.1, 0.25)
    lost = SunsatChain().parameters(PROFILE, None, commanded, Mode.LOST_IN_SPACE)
    assert lost.hint_error_rad == PARAMETERS.hint_error_rad


def test_dark_average_follows_each_row_and_ignores_stars() -> None:
    """A drifting offset (§2.2.1.2) is found per row to a tenth of a level, stars or not."""
    rng = np.random.default_rng(1)
    drift = np.linspace(20, 8, 582)
    frame = np.rint(drift[:, None] + rng.normal(0, 1.2, (582, 752)))
    frame[100:110, 300:320] = 200
    dark = dark_rows_dn(frame.astype(np.uint8), PARAMETERS.dark_clip_dn)
    assert np.max(np.abs(dark - drift)) < 0.35
    assert abs(float(np.mean(dark - drift))) < 0.05


def test_drift_of_the_offset_does_not_hide_stars() -> None:
    """A frame whose lower rows are ten levels darker than its upper ones shows the same stars as one without drift."""
    rng = np.random.default_rng(2)
    spots = [FalseStar(100 + 60 * k, 40 + 50 * k, 4.5) for k in range(10)]
    frame = render(NO_STARS, CAMERA, SENSOR, np.eye(3), 0.5, rng, false_stars=spots).pixels
    drifting = (frame + np.rint(np.linspace(10, 0, 582))[:, None]).astype(np.uint8)
    assert len(find_in_frame(frame, PARAMETERS).centroids) == 10
    assert len(find_in_frame(drifting, PARAMETERS).centroids) == 10


def test_areas_edges_and_shape_are_judged() -> None:
    """Nine pixels are noise, 301 no star, a region at the border is cut, a line is too long; each with its reason."""
    level = np.zeros((200, 200))
    level[20:23, 20:23] = 50  # 9
    level[30:35, 30:32] = 50  # 10
    level[60:80, 60:76] = 50  # 320
    level[0:4, 100:104] = 50  # at the edge
    level[120, 20:40] = 50  # 20 in a line
    level[121, 20:40] = 50
    found = find_stars(level, PARAMETERS)
    assert len(found.centroids) == 1
    assert found.invalid == 1
    reasons = sorted(r.rejected for r in found.regions)
    assert [r.split()[:1] for r in reasons] == [[], ["area"], ["area"], ["elongation"], ["touches"]]
    assert reasons[3] == "elongation 18.0 px, at most 12"


def test_only_the_first_twenty_are_taken() -> None:
    """§2.3: the scan from the first row ends at the twentieth star and says so."""
    level = np.zeros((200, 200))
    for k in range(30):
        level[5 + 12 * (k // 6) : 9 + 12 * (k // 6), 10 + 25 * (k % 6) : 14 + 25 * (k % 6)] = 40
    found = find_stars(level, PARAMETERS)
    assert len(found.centroids) == 20
    assert found.stopped == "search stopped at 20 stars"
    assert found.centroids.row_px.max() < 9 + 12 * 3


def _ellipse(a: float, b: float, angle: float) -> Blobs:
    """Pixels within an ellipse; the angle counts from u = −x towards v = +y."""
    row, col = np.indices((60, 80))
    u, v = -(col - 40.0), row - 30.0
    along, across = u * np.cos(angle) + v * np.sin(angle), v * np.cos(angle) - u * np.sin(angle)
    return find_blobs(((along / a) ** 2 + (across / b) ** 2 <= 1).astype(float), 0.5, 1)


@pytest.mark.parametrize("angle", np.radians([-80, -45, -20, 0, 30, 60, 85]))
def test_direction_and_lengths_of_a_long_region(angle: float) -> None:
    """The long axis of an ellipse of half axes 12 and 4 is found to 2°, its lengths between pixel centres, which
    are up to two pixels less, to a pixel and a half."""
    shape = shapes(_ellipse(12, 4, angle))
    turn = (float(shape.direction_rad[0]) - angle + np.pi / 2) % np.pi - np.pi / 2
    assert abs(np.degrees(turn)) < 2
    assert float(shape.long_px[0]) == pytest.approx(23, abs=1.5)
    assert float(shape.short_px[0]) == pytest.approx(7, abs=1.5)


def test_direction_is_the_documents_formula() -> None:
    """Eq. 2.8 with its three cases gives the same angle as half the two-argument arctangent."""
    rng = np.random.default_rng(3)
    for m20, m02, m11 in zip(rng.uniform(0, 9, 200), rng.uniform(0, 9, 200), rng.uniform(-9, 9, 200), strict=True):
        n = 0 if m20 >= m02 else (1 if m11 >= 0 else -1)
        printed = 0.5 * np.arctan(2 * m11 / (m20 - m02)) + n * np.pi / 2
        assert 0.5 * np.arctan2(2 * m11, m20 - m02) == pytest.approx(printed, abs=1e-12)


def test_expected_streaks_are_distinguished_from_doubles() -> None:
    """With history the elongation must be as expected within two pixels and, if long, within 30° (eq. 2.9–2.10)."""
    blob = _ellipse(8, 3, 0.3)
    level = np.zeros((60, 80))
    level.ravel()[blob.index] = 50
    measured = float(shapes(blob).long_px[0] - shapes(blob).short_px[0])
    assert len(find_stars(level, PARAMETERS, Streak(measured, 0.35)).centroids) == 1
    across = find_stars(level, PARAMETERS, Streak(measured, 0.3 + np.pi / 2))
    assert "across the expected streak" in across.regions[0].rejected
    short = find_stars(level, PARAMETERS, Streak(0.0, 0.0))
    assert "expected 0.0" in short.regions[0].rejected


def test_centroid_is_the_centre_of_gravity_above_threshold() -> None:
    """By hand: brightness 1, 2, 3 above threshold in a row weigh the columns; eq. C.1 adds twice the light below."""
    level = np.zeros((3, 9))
    level[1, 3:6] = PARAMETERS.threshold_dn + np.array([1.0, 2.0, 3.0])
    one = gravity_centroids(level, find_blobs(level, PARAMETERS.threshold_dn, 1), PARAMETERS)
    assert float(one.col_px[0]) == pytest.approx((3 + 8 + 15) / 6)
    assert float(one.row_px[0]) == 1.0
    assert float(one.flux_dn[0]) == pytest.approx(6 + 2 * 3 * PARAMETERS.threshold_dn)


def test_magnitude_and_brightness_are_inverse() -> None:
    """Eqs. 2.12–2.13 and C.4 undo each other; no light has no magnitude."""
    v_mag = np.linspace(1, 7, 13)
    np.testing.assert_allclose(magnitudes(brightness_dn(v_mag, PARAMETERS), PARAMETERS), v_mag, atol=1e-12)
    assert np.isnan(magnitudes(np.array([0.0, -1.0]), PARAMETERS)).all()


def test_rendered_magnitudes_and_places_are_the_documents_or_better() -> None:
    """Isolated stars of V 3 to 6 in rendered frames: 0.2 mag (§6.3) and 0.24 px (§6.2.3), and errors of the stated size."""
    rng = np.random.default_rng(4)
    off, wrong_mag, normed = [], [], []
    for _ in range(4):
        at = [(60 + 90 * i + rng.uniform(-9, 9), 60 + 90 * j + rng.uniform(-9, 9)) for i in range(8) for j in range(5)]
        v_mag = rng.uniform(3, 6, len(at))
        spots = [FalseStar(c, r, v) for (c, r), v in zip(at, v_mag, strict=True)]
        frame = render(NO_STARS, CAMERA, SENSOR, np.eye(3), 0.5, rng, false_stars=spots).pixels
        found = find_in_frame(frame, replace(PARAMETERS, max_found=100)).centroids
        away = np.linalg.norm(found.pixels[:, None] - np.array(at)[None], axis=-1)
        who = np.argmin(away, axis=1)
        assert len(found) >= 39
        assert away.min(axis=1).max() < 1
        d = found.pixels - np.array(at)[who]
        off.append(d.ravel())
        normed.append((d / found.sigma_px[:, None]).ravel())
        wrong_mag.append(magnitudes(found.flux_dn, PARAMETERS) - v_mag[who])
    assert float(np.std(np.concatenate(off))) < 0.1
    assert float(np.std(np.concatenate(wrong_mag))) < 0.2
    assert abs(float(np.mean(np.concatenate(wrong_mag)))) < 0.1
    assert 0.6 < float(np.std(np.concatenate(normed))) < 1.2


def test_a_window_gives_the_frames_result() -> None:
    """A star found in a cut-out has the place and brightness that it has in the whole frame."""
    rng = np.random.default_rng(5)
    frame = render(NO_STARS, CAMERA, SENSOR, np.eye(3), 0.5, rng, false_stars=[FalseStar(400.3, 200.7, 4.0)]).pixels
    level = frame - dark_rows_dn(frame, PARAMETERS.dark_clip_dn)[:, None]
    whole = find_stars(level, PARAMETERS)
    # A cut at a multiple of three keeps the scan's grid.
    part = moved(find_stars(level[180:222, 381:420], PARAMETERS), 381, 180)
    np.testing.assert_allclose(part.centroids.pixels, whole.centroids.pixels, atol=1e-9)
    np.testing.assert_allclose(part.centroids.flux_dn, whole.centroids.flux_dn)
    assert part.regions[0].col_min == next(r for r in whole.regions if not r.rejected).col_min
