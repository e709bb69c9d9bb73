"""Sunsat's detection: dark rows, area limits, edge rule, shape test, centre of gravity and magnitude."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.errors import BadInput
from gss.domain.sensor import Defects
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.onboard import Commanded
from gss.pipeline.chains.sunsat import find_in_frame
from gss.pipeline.chains.sunsat_detect import (
    Streak,
    brightness_dn,
    find_stars,
    gravity_centroids,
    magnitudes,
    moved,
    shapes,
    sky_rows_dn,
    zero_rows_dn,
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
    """Each field of the parameters is in SOURCES."""
    unsourced = {"focal_mm", "exposure_s", "max_small_regions"}
    names = set(SunsatParameters.__dataclass_fields__) - unsourced
    assert names <= set(SOURCES)


@pytest.mark.parametrize(
    "change",
    [{"threshold_dn": 0.0}, {"min_area_px": 400}, {"matcher": "luck"}, {"acceptance": "hope"}, {"min_group": 2}],
)
def test_invalid_parameters_are_rejected(change: dict[str, float]) -> None:
    """Invalid thresholds, areas and names are rejected."""
    with pytest.raises(BadInput):
        replace(PARAMETERS, **change)


def test_commanded_values_are_used() -> None:
    """Commanded threshold and areas are used in every mode, and the commanded hint radius only in assisted mode."""
    commanded = Commanded(threshold_dn=9, min_area_px=4, max_area_px=50, hint_radius_rad=0.1)
    parameters = SunsatChain().parameters(PROFILE, 0.25, commanded, Mode.ASSISTED)
    assert (
        parameters.threshold_dn,
        parameters.min_area_px,
        parameters.max_area_px,
        parameters.hint_error_rad,
        parameters.exposure_s,
    ) == (9, 4, 50, 0.1, 0.25)
    lost = SunsatChain().parameters(PROFILE, None, commanded, Mode.LOST_IN_SPACE)
    assert lost.hint_error_rad == PARAMETERS.hint_error_rad


def test_sky_level_follows_each_row_and_ignores_stars() -> None:
    """A drifting offset (§2.2.1.2) is measured per row within 0.35 DN, also in rows with stars."""
    rng = np.random.default_rng(1)
    drift = np.linspace(20, 8, 582)
    frame = np.rint(drift[:, None] + rng.normal(0, 1.2, (582, 752)))
    frame[100:110, 300:320] = 200
    dark = sky_rows_dn(frame.astype(np.uint8), PARAMETERS.dark_clip_dn)
    assert np.max(np.abs(dark - drift)) < 0.35
    assert abs(float(np.mean(dark - drift))) < 0.05


@pytest.mark.parametrize("background_dn", [0.0, 3.0])
def test_dark_average_is_the_mean_of_43_dark_columns(background_dn: float) -> None:
    """The level of a row is its dark average plus the background of the rows around it, also if an object covers most of
    the row."""
    rng = np.random.default_rng(3)
    drift = np.linspace(20, 8, 582)[:, None]
    dark = np.rint(drift + rng.normal(0, 1.2, (582, 43))).astype(np.uint8)
    frame = np.rint(drift + background_dn + rng.normal(0, 1.2, (582, 752)))
    frame[100:110, :500] += 20
    zero_dn, note = zero_rows_dn(frame.astype(np.uint8), dark, PARAMETERS)
    assert np.max(np.abs(zero_dn - background_dn - drift[:, 0])) < 5 * 1.25 / np.sqrt(43)
    assert abs(float(np.mean(zero_dn - drift[:, 0])) - background_dn) < 0.06
    assert "43 dark columns" in note
    without = zero_rows_dn(frame.astype(np.uint8), None, PARAMETERS)[0]
    assert np.abs(without - drift[:, 0])[100:110].min() > 10 + background_dn


def test_background_follows_uneven_stray_light() -> None:
    """Stray light that grows by 20 levels from the first to the last row leaves an error below one level."""
    rng = np.random.default_rng(4)
    stray = np.linspace(0, 20, 582)
    dark = np.rint(10 + rng.normal(0, 1.2, (582, 43))).astype(np.uint8)
    frame = np.rint(10 + stray[:, None] + rng.normal(0, 1.2, (582, 752))).astype(np.uint8)
    zero_dn, _ = zero_rows_dn(frame, dark, PARAMETERS)
    assert np.max(np.abs(zero_dn - 10 - stray)) < 1.5
    assert np.sqrt(np.mean((zero_dn - 10 - stray) ** 2)) < 0.3


def test_stars_of_a_drifting_image_are_found_with_dark_columns() -> None:
    """The ac-coupled amplifier changes the level of the rows; the stars of the image have the same positions as without
    the drift."""
    spots = [FalseStar(100 + 60 * k, 40 + 50 * k, 4.5) for k in range(10)]
    sensor = replace(SENSOR, background_e_s=600.0)
    parameters = default_parameters(replace(PROFILE, sensor=sensor))
    lists = []
    for coupling_px in (0.0, 57800.0):
        rng, defects = np.random.default_rng(2), Defects(coupling_px=coupling_px)
        frame = render(NO_STARS, CAMERA, sensor, np.eye(3), 0.5, rng, false_stars=spots, defects=defects)
        lists.append(find_in_frame(frame.pixels, parameters, frame.dark).centroids.pixels)
        lists[-1] = lists[-1][np.argsort(lists[-1][:, 0])]
        assert frame.dark is not None
        fall_dn = float(frame.dark[:20:2].mean() - frame.dark[-20:].mean())
        assert fall_dn > 6 if coupling_px else abs(fall_dn) < 0.3
    assert len(lists[0]) == len(lists[1]) == 10
    assert np.max(np.abs(lists[0] - lists[1])) < 0.2


def test_drift_of_the_offset_does_not_hide_stars() -> None:
    """A frame whose lower rows are ten levels darker than its upper rows gives the same number of stars as one without
    drift.
    """
    rng = np.random.default_rng(2)
    spots = [FalseStar(100 + 60 * k, 40 + 50 * k, 4.5) for k in range(10)]
    frame = render(NO_STARS, CAMERA, SENSOR, np.eye(3), 0.5, rng, false_stars=spots).pixels
    drifting = (frame + np.rint(np.linspace(10, 0, 582))[:, None]).astype(np.uint8)
    assert len(find_in_frame(frame, PARAMETERS).centroids) == 10
    assert len(find_in_frame(drifting, PARAMETERS).centroids) == 10


def test_regions_are_rejected_by_area_edge_and_shape() -> None:
    """Regions that are too small, too large, too long or at the edge are rejected with their reason."""
    level = np.zeros((200, 200))
    level[20:23, 20:23] = 50  # 9
    level[30:35, 30:32] = 50  # 10
    level[60:80, 60:76] = 50  # 320
    level[0:4, 100:104] = 50  # at the edge
    level[120, 20:40] = 50  # 2 x 20
    level[121, 20:40] = 50
    detected = find_stars(level, PARAMETERS)
    assert len(detected.centroids) == 1
    assert detected.invalid == 1
    reasons = sorted(r.rejected for r in detected.regions)
    assert [r.split()[:1] for r in reasons] == [[], ["area"], ["area"], ["elongation"], ["touches"]]
    assert reasons[3] == "elongation 18.0 px, at most 12"


def test_the_search_stops_at_twenty_stars() -> None:
    """The scan from the first row stops at the twentieth star and states it (§2.3)."""
    level = np.zeros((200, 200))
    for k in range(30):
        level[5 + 12 * (k // 6) : 9 + 12 * (k // 6), 10 + 25 * (k % 6) : 14 + 25 * (k % 6)] = 40
    detected = find_stars(level, PARAMETERS)
    assert len(detected.centroids) == 20
    assert detected.stopped == "search stopped at 20 stars"
    assert detected.centroids.row_px.max() < 9 + 12 * 3


def _ellipse(a: float, b: float, angle: float) -> Blobs:
    """Return the pixels within an ellipse. The angle is counted from u = −x towards v = +y."""
    row, col = np.indices((60, 80))
    u, v = -(col - 40.0), row - 30.0
    along, across = u * np.cos(angle) + v * np.sin(angle), v * np.cos(angle) - u * np.sin(angle)
    return find_blobs(((along / a) ** 2 + (across / b) ** 2 <= 1).astype(float), 0.5, 1)


@pytest.mark.parametrize("angle", np.radians([-80, -45, -20, 0, 30, 60, 85]))
def test_direction_and_lengths_of_a_long_region(angle: float) -> None:
    """The direction of an ellipse with half axes 12 and 4 is measured within 2°. Its lengths between pixel centres, up
    to two pixels shorter than the axes, are measured within 1.5 px.
    """
    shape = shapes(_ellipse(12, 4, angle))
    error_rad = (float(shape.direction_rad[0]) - angle + np.pi / 2) % np.pi - np.pi / 2
    assert abs(np.degrees(error_rad)) < 2
    assert float(shape.long_px[0]) == pytest.approx(23, abs=1.5)
    assert float(shape.short_px[0]) == pytest.approx(7, abs=1.5)


def test_direction_agrees_with_the_printed_formula() -> None:
    """Eq. 2.8 with its three cases equals half the two-argument arctangent."""
    rng = np.random.default_rng(3)
    for m20, m02, m11 in zip(rng.uniform(0, 9, 200), rng.uniform(0, 9, 200), rng.uniform(-9, 9, 200), strict=True):
        n = 0 if m20 >= m02 else (1 if m11 >= 0 else -1)
        printed = 0.5 * np.arctan(2 * m11 / (m20 - m02)) + n * np.pi / 2
        assert 0.5 * np.arctan2(2 * m11, m20 - m02) == pytest.approx(printed, abs=1e-12)


def test_expected_streaks_are_distinguished_from_doubles() -> None:
    """With a known motion, the elongation must be as expected within two pixels and, for long streaks, the direction
    within 30° (eq. 2.9–2.10).
    """
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
    """Brightness values of 1, 2 and 3 above the threshold are the weights of their columns. Eq. C.1 adds twice the
    light below the threshold.
    """
    level = np.zeros((3, 9))
    level[1, 3:6] = PARAMETERS.threshold_dn + np.array([1.0, 2.0, 3.0])
    centroid = gravity_centroids(level, find_blobs(level, PARAMETERS.threshold_dn, 1), PARAMETERS)
    assert float(centroid.col_px[0]) == pytest.approx((3 + 8 + 15) / 6)
    assert float(centroid.row_px[0]) == 1.0
    assert float(centroid.flux_dn[0]) == pytest.approx(6 + 2 * 3 * PARAMETERS.threshold_dn)


def test_magnitude_and_brightness_are_inverse() -> None:
    """Eqs. 2.12–2.13 are the inverse of eq. C.4. Without light the magnitude is NaN."""
    v_mag = np.linspace(1, 7, 13)
    np.testing.assert_allclose(magnitudes(brightness_dn(v_mag, PARAMETERS), PARAMETERS), v_mag, atol=1e-12)
    assert np.isnan(magnitudes(np.array([0.0, -1.0]), PARAMETERS)).all()


def test_magnitudes_and_positions_are_more_accurate_than_in_the_document() -> None:
    """Isolated rendered stars of V 3 to 6 have errors below 0.2 mag (§6.3) and 0.1 px (document: 0.24 px, §6.2.3), and
    the stated σ agrees with the errors.
    """
    rng = np.random.default_rng(4)
    errors_px, errors_mag, normalised = [], [], []
    for _ in range(4):
        true_px = [
            (60 + 90 * i + rng.uniform(-9, 9), 60 + 90 * j + rng.uniform(-9, 9)) for i in range(8) for j in range(5)
        ]
        v_mag = rng.uniform(3, 6, len(true_px))
        spots = [FalseStar(c, r, v) for (c, r), v in zip(true_px, v_mag, strict=True)]
        frame = render(NO_STARS, CAMERA, SENSOR, np.eye(3), 0.5, rng, false_stars=spots).pixels
        centroids = find_in_frame(frame, replace(PARAMETERS, max_found=100)).centroids
        distance_px = np.linalg.norm(centroids.pixels[:, None] - np.array(true_px)[None], axis=-1)
        nearest = np.argmin(distance_px, axis=1)
        assert len(centroids) >= 39
        assert distance_px.min(axis=1).max() < 1
        error_px = centroids.pixels - np.array(true_px)[nearest]
        errors_px.append(error_px.ravel())
        normalised.append((error_px / centroids.sigma_px[:, None]).ravel())
        errors_mag.append(magnitudes(centroids.flux_dn, PARAMETERS) - v_mag[nearest])
    assert float(np.std(np.concatenate(errors_px))) < 0.1
    assert float(np.std(np.concatenate(errors_mag))) < 0.2
    assert abs(float(np.mean(np.concatenate(errors_mag)))) < 0.1
    assert 0.6 < float(np.std(np.concatenate(normalised))) < 1.2


def test_a_window_gives_the_same_result_as_the_frame() -> None:
    """A star in a part of the frame has the same position and brightness as in the whole frame."""
    rng = np.random.default_rng(5)
    frame = render(NO_STARS, CAMERA, SENSOR, np.eye(3), 0.5, rng, false_stars=[FalseStar(400.3, 200.7, 4.0)]).pixels
    level = frame - sky_rows_dn(frame, PARAMETERS.dark_clip_dn)[:, None]
    whole_frame = find_stars(level, PARAMETERS)
    # A part that starts at a multiple of three has the same scan grid.
    part = moved(find_stars(level[180:222, 381:420], PARAMETERS), 381, 180)
    np.testing.assert_allclose(part.centroids.pixels, whole_frame.centroids.pixels, atol=1e-9)
    np.testing.assert_allclose(part.centroids.flux_dn, whole_frame.centroids.flux_dn)
    assert part.regions[0].col_min == next(r for r in whole_frame.regions if not r.rejected).col_min
