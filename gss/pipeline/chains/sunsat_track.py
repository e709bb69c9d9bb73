"""Sunsat's Tracking algorithm (Jacobs 1995 ch. 4): the attitude is predicted, each expected star is searched for in a
separate window, and the first three well-spread stars with the right distances are used."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array, cross
from gss.domain.camera import Camera
from gss.domain.results import Centroids, Region
from gss.domain.rotation import matrix_from_quaternion
from gss.pipeline.chains.modes import AttitudePrior, Mode
from gss.pipeline.chains.onboard import Detection
from gss.pipeline.chains.sunsat_detect import (
    DetectedStars,
    Streak,
    brightest,
    brightness_dn,
    find_stars,
    magnitudes,
    moved,
    zero_rows_dn,
)
from gss.pipeline.chains.sunsat_match import SunsatCatalogue, SunsatMatching, last_attitude, widest_pair
from gss.pipeline.chains.sunsat_parameters import CENTROID_ERROR_PX, FASTEST_RAD_S, FURTHEST_RAD, SunsatParameters
from gss.pipeline.regions import Pixels
from gss.pipeline.track.predictor import predict_attitude
from gss.pipeline.track.sphere_field import sphere_field, stars_inside
from gss.pipeline.track.three_stars import PAIR, STARS, Candidates, ThreeStars, by_boxes

Rows = NDArray[np.intp]
SAME_STAR_PX = 0.5
FLAT_TRIANGLE = 0.1


@dataclass(frozen=True)
class ReferenceStars:
    """k reference stars in search order: catalogue ``row``, ``pixels`` (k, 2), half side of each window (k,), and the expected
    streak of each, or None without history."""

    row: Rows
    pixels: Array
    radius_px: Array
    streak: tuple[Streak, ...] | None

    def __len__(self) -> int:
        return len(self.row)


def expected_stars(
    camera: Camera, catalogue: SunsatCatalogue, p: SunsatParameters, hint: AttitudePrior
) -> ReferenceStars:
    """Return the stars predicted in the field and their positions (§4.1.2–4.1.4, §4.1.6.3, §4.1.8)."""
    last = last_attitude(hint)
    attitude = predict_attitude(last, hint.earlier, hint.ages_s)
    row, pixels = _in_view(camera, catalogue, attitude)
    uncertain_px = uncertainty_px(camera, catalogue, p, hint)
    radius_px = np.ceil(_star_radius_px(catalogue.guides.v_mag[row], p.star_sigma_px, p) + uncertain_px + p.rotation_px)
    streak = None
    if hint.earlier:
        # The motion since the stars' positions at the last attitude determines the streaks.
        back = camera.unproject(pixels) @ (matrix_from_quaternion(last) @ attitude.T).T
        streak = _streaks((pixels - camera.project(back)) / hint.ages_s[0], catalogue.guides.v_mag[row], p)
    return ReferenceStars(row, pixels, radius_px, streak)


def _in_view(camera: Camera, catalogue: SunsatCatalogue, attitude: Array) -> tuple[Rows, Array]:
    """Return the catalogue stars in the field, in the order of the nine boxes, and their pixels."""
    field = sphere_field(camera.corners() @ attitude)
    row = stars_inside(field, catalogue.ra_rad, catalogue.dec_rad)
    pixels = camera.project(catalogue.guides.unit[row] @ attitude.T)
    on = camera.contains(pixels)
    row, pixels = row[on], pixels[on]
    order = by_boxes(pixels, camera.columns, camera.rows)
    return row[order], pixels[order]


def uncertainty_px(camera: Camera, catalogue: SunsatCatalogue, p: SunsatParameters, hint: AttitudePrior) -> float:
    """Return the error of an expected position (eq. 4.20). In the first iteration, it is the error of another sensor's
    attitude. In later iterations, it is the error of TRIAD, which depends on the separation of the pair in the last
    iteration. This pair is reconstructed as the widest pair of the first three stars that were expected at that time. A
    prediction over several steps multiplies the error by their number. The error of a prediction from a single attitude
    is the fastest rotation since the time of this attitude (eq. 3.6)."""
    if not hint.earlier:
        turned_px = min(FASTEST_RAD_S * hint.ages_s[0], FURTHEST_RAD) / camera.pixel_rad
        return max(p.uncertain_adcs_px, turned_px)
    _, pixels = _in_view(camera, catalogue, matrix_from_quaternion(last_attitude(hint)))
    first = pixels[:STARS] / np.array([camera.focal_col_px, camera.focal_row_px]) * p.focal_mm
    if len(first) < PAIR:
        return p.uncertain_adcs_px
    widest_mm = float(np.max(np.linalg.norm(first[:, None] - first[None], axis=-1)))
    error_px = p.uncertain_reach_mm * CENTROID_ERROR_PX / max(widest_mm, 1e-9) * max(1.0, hint.steps)
    return float(np.clip(error_px, p.uncertain_least_px, p.uncertain_adcs_px))


def off_prediction_px(
    cam_from_icrs: Array, camera: Camera, catalogue: SunsatCatalogue, p: SunsatParameters, hint: AttitudePrior
) -> tuple[float, float]:
    """Return the distance of the field's corners from their expected positions, and its limit, px.

    The limit is the size of the windows on both axes. The test is needed because three stars close together can be in
    their windows even if the field is rotated.
    """
    expected = predict_attitude(last_attitude(hint), hint.earlier, hint.ages_s)
    corners = camera.corners()
    step = corners @ (cam_from_icrs @ expected.T).T - corners
    reach_px = uncertainty_px(camera, catalogue, p, hint) + p.rotation_px
    return float(np.max(np.linalg.norm(step, axis=1))) / camera.pixel_rad, float(np.sqrt(2.0) * reach_px)


def _star_radius_px(v_mag: Array, sigma_px: Array | float, p: SunsatParameters) -> Array:
    """Return the half width above threshold of a Gaussian spot along an axis with standard deviation ``sigma_px``. The
    other axis has the normal star width. The brightness approximates the total light with sufficient accuracy."""
    peak = brightness_dn(v_mag, p) / (2 * np.pi * p.star_sigma_px * _longest(sigma_px, p))
    return np.asarray(sigma_px * np.sqrt(2 * np.log(np.maximum(peak / p.threshold_dn, 1.0))))


def _longest(sigma_px: Array | float, p: SunsatParameters) -> Array:
    return np.asarray(np.maximum(sigma_px, p.star_sigma_px))


def _streaks(rate_px_s: Array, v_mag: Array, p: SunsatParameters) -> tuple[Streak, ...]:
    """Return the streaks in one exposure from the stars' motion per second; u is opposite to the columns.

    The document expects a region to be longer by the full motion (§2.2.3). However, a motion of a few pixels adds only
    a twelfth of its square to the variance of a spot, which determines the contour. It lengthens the contour of a soft
    spot by less than the motion, and hardly changes the contour of a faint star.
    """
    moved_px = np.linalg.norm(rate_px_s, axis=1) * p.exposure_s
    along_px = np.sqrt(p.star_sigma_px**2 + moved_px**2 / 12)
    longer = 2 * _star_radius_px(v_mag, along_px, p) * (1 - p.star_sigma_px / along_px)
    direction = np.arctan2(rate_px_s[:, 1], -rate_px_s[:, 0])
    return tuple(Streak(float(e), float(d)) for e, d in zip(longer, direction, strict=True))


def find_in_windows(
    pixels: Pixels,
    camera: Camera,
    catalogue: SunsatCatalogue,
    p: SunsatParameters,
    hint: AttitudePrior,
    dark: Pixels | None = None,
) -> Detection:
    """Find stars in the windows of expected stars, one window at a time until three fit (§4.1.4.1), then a few more for
    confirmation. Every window is cut from the unmodified frame. A star that is detected in two windows is used once.
    ``dark``: (rows, n) pixels of the dark columns."""
    expected = expected_stars(camera, catalogue, p, hint)
    zero_dn, level_note = zero_rows_dn(pixels, dark, p)
    window_stars: list[DetectedStars] = []
    stars = Centroids.from_pixels(np.empty((0, 2)))
    end = len(expected)
    for k in range(len(expected)):
        if k >= end:
            break
        detected = _search_window(pixels, zero_dn, expected, k, p)
        window_stars.append(detected)
        fresh = _new_ones(stars, detected.centroids)
        stars = _joined(stars, detected.centroids.take(fresh))
        if end == len(expected) and len(stars) >= STARS:
            test, counts = _three_stars(stars, camera, catalogue, p, expected, k + 1)
            end = len(counts) + p.confirm_windows if test.result else end
    regions: dict[tuple[int, int, int, int], Region] = {}
    for detected in window_stars:
        for r in detected.regions:
            regions.setdefault((r.col_min, r.row_min, r.col_max, r.row_max), r)
    centroids = stars.take(brightest(stars))
    notes = (f"searched {len(window_stars)} of {len(expected)} windows", level_note)
    return Detection(
        tuple(regions.values()), centroids, sum(f.invalid for f in window_stars), float(np.median(zero_dn)), notes
    )


def _search_window(
    pixels: Pixels, zero_dn: Array, expected: ReferenceStars, k: int, p: SunsatParameters
) -> DetectedStars:
    rows, columns = pixels.shape
    col, row = np.rint(expected.pixels[k]).astype(int).tolist()
    r = int(expected.radius_px[k])
    left, top = max(0, col - r), max(0, row - r)
    right, bottom = min(columns, col + r + 1), min(rows, row + r + 1)
    level = pixels[top:bottom, left:right].astype(np.float32) - zero_dn[top:bottom, None].astype(np.float32)
    return moved(find_stars(level, p, None if expected.streak is None else expected.streak[k]), left, top)


def _new_ones(existing: Centroids, new: Centroids) -> Rows:
    off = np.linalg.norm(new.pixels[:, None] - existing.pixels[None], axis=-1)
    return np.flatnonzero((off > SAME_STAR_PX).all(axis=1))


def _joined(a: Centroids, b: Centroids) -> Centroids:
    names = ("col_px", "row_px", "flux_dn", "peak_dn", "area_px", "sigma_px")
    return Centroids(*(np.concatenate([getattr(a, n), getattr(b, n)]) for n in names))


def _three_stars(
    centroids: Centroids,
    camera: Camera,
    catalogue: SunsatCatalogue,
    p: SunsatParameters,
    expected: ReferenceStars,
    windows: int,
) -> tuple[ThreeStars, list[int]]:
    """Run the three-star test over the first ``windows`` expected stars. Also return the number of candidates of each star used."""
    unit = camera.unproject(centroids.pixels)
    v_mag = magnitudes(centroids.flux_dn, p)
    off_px = np.abs(centroids.pixels[None] - expected.pixels[:windows, None])
    near = (off_px <= expected.radius_px[:windows, None, None]).all(axis=-1)
    guide_mag = catalogue.guides.v_mag[expected.row[:windows]]
    near &= np.abs(v_mag[None] - guide_mag[:, None]) <= p.magnitude_tolerance_mag
    near &= np.isfinite(unit).all(axis=1)
    test = ThreeStars(unit, catalogue.guides.unit, p.distance_tolerance_rad)
    counts: list[int] = []
    for k in range(windows):
        observed = np.flatnonzero(near[k])
        counts.append(len(observed))
        if test.add(Candidates(int(expected.row[k]), observed)):
            break
    return test, counts


def match_tracking(
    centroids: Centroids, camera: Camera, catalogue: SunsatCatalogue, p: SunsatParameters, hint: AttitudePrior
) -> SunsatMatching:
    """Identify three stars detected in the windows of expected stars, or two if no three fit (§4.1.4.1)."""
    expected = expected_stars(camera, catalogue, p, hint)
    test, counts = _three_stars(centroids, camera, catalogue, p, expected, len(expected))
    chosen = sorted(test.result or test.pair)
    row = np.full(len(centroids), -1, np.intp)
    selected = np.array([k for k, _ in chosen], np.intp)
    row[selected] = [g for _, g in chosen]
    weight = np.zeros(len(centroids))
    weight[list(widest_pair(test.unit_cam, selected))] = 1.0
    reason = "" if chosen else f"no two of {len(expected)} expected stars found at their distance"
    return SunsatMatching(
        Mode.TRACKING,
        test.unit_cam,
        magnitudes(centroids.flux_dn, p),
        row,
        selected,
        weight,
        test.operations,
        _accidents(counts, expected, catalogue.guides.unit[row[selected]], p, camera),
        len(expected),
        1 if chosen else 0,
        sum(counts),
        reason,
        expected.row[: len(counts) + p.confirm_windows],
    )


def _accidents(
    counts: list[int], expected: ReferenceStars, reference: Array, p: SunsatParameters, camera: Camera
) -> float:
    """Return the expected number of sets of three (or two) stars that fit by accident.

    The number of false stars per window is estimated from the candidates beyond the first of each window, plus one. A
    false candidate can be anywhere in its window, so the probability that a distance fits is the share of the window
    that the tolerance covers. In a flat triangle, the other two distances determine the third.
    """
    if not len(reference) or not counts:
        return 1.0
    windows, stars = len(counts), len(reference)
    false = (sum(max(0, c - 1) for c in counts) + 1) / windows
    radius_px = float(np.min(expected.radius_px[:windows]))
    fits = min(1.0, np.sqrt(2.0) * p.distance_tolerance_rad / camera.pixel_rad / radius_px)
    distances = 1
    if stars == STARS:
        sides = reference[1:] - reference[0]
        area = float(np.linalg.norm(cross(sides[0], sides[1])))
        flat = area < FLAT_TRIANGLE * float(np.linalg.norm(sides[0]) * np.linalg.norm(sides[1]))
        distances = 2 if flat else 3
    return float(min(1.0, comb(max(windows, stars), stars) * false**stars * fits**distances))
