"""Liebe's and Moniteq's tables rerun in small: the figures lie where the documents' do, a seed names a run."""

from __future__ import annotations

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.experiment import Experiment
from validation.liebe.sky import SITUATIONS, USED_STARS, catalogue, image, instrument
from validation.liebe.tables import liebe_2, liebe_3, liebe_18
from validation.moniteq.locator import moniteq_4_2, moniteq_nea, moniteq_noise
from validation.moniteq.screening import moniteq_screening
from validation.moniteq.sky import moniteq_2_1, moniteq_links

STARS = load_stars(8.0)


def _quiet(_: float) -> None:
    return None


def _number(cell: object) -> float:
    return float(str(cell).split()[0])


def _row(made: Experiment, begins: str) -> tuple[object, ...]:
    return next(row for row in made.rows if str(row[0]).startswith(begins))


def test_the_field_is_liebes() -> None:
    """1107 stars in 707 square degrees are 18.9 to a field (Fig. 2), and the list is as deep as the data base needs."""
    camera = instrument().camera
    width, height = camera.fov_rad
    area_deg2 = 4 * np.degrees(np.degrees(np.arcsin(np.sin(width / 2) * np.sin(height / 2))))
    assert area_deg2 == pytest.approx(702.98, abs=1)
    assert USED_STARS * area_deg2 / 41_253 == pytest.approx(18.9, abs=0.1)
    assert len(catalogue(STARS)) == pytest.approx(1539, rel=0.05)


def test_images_have_the_errors_they_say() -> None:
    """One false star has no row, a missing one is not there, and one outside tolerance is the only one beyond 3′."""
    bank, camera = catalogue(STARS), instrument().camera
    for situation in SITUATIONS:
        seen = image(bank, camera, np.eye(3), situation, np.random.default_rng(3))
        true = seen.row >= 0
        off = np.linalg.norm(seen.centroids.pixels[true] - camera.project(bank.icrs[seen.row[true]]), axis=1)
        assert np.count_nonzero(~true) == situation.false
        assert np.count_nonzero(off * camera.pixel_rad > np.radians(0.0501)) == situation.outside


def test_initial_estimates_succeed_as_often_as_liebes() -> None:
    """Fifty images per row: the clean row within 10 % of the document, proof makes it no worse and never wrong."""
    progress: list[float] = []
    made = liebe_2(STARS, 50, 2, progress.append)
    assert abs(_number(made.rows[0][2]) - 94.6) < 10
    assert _number(made.rows[4][2]) < _number(made.rows[0][2])
    for row in made.rows:
        assert _number(row[4]) >= _number(row[2]) - 2
        assert row[5] == 0
    assert progress == sorted(progress)
    assert progress[-1] == 1.0


def test_predictional_estimates_are_as_good_as_liebes() -> None:
    """Forty images per row: mean within 30 % of 14.6″ with the stars inside 3′, worse with every nearest star."""
    made = liebe_3(STARS, 40, 2, _quiet)
    for row in made.rows:
        assert _number(row[3]) == pytest.approx(14.6, rel=0.3)
        assert _number(row[4]) >= 97
    assert _number(made.rows[3][2]) > 1.5 * _number(made.rows[3][3])


def test_the_boresight_is_better_with_more_stars_by_the_root() -> None:
    """Four hundred estimates: σ_axis √n over σ_star is one within 10 %, and the same by seed."""
    made = liebe_18(STARS, 400, 2, _quiet)
    assert _number(_row(made, "all: rms")[2]) == pytest.approx(1.0, abs=0.1)
    assert _number(_row(made, "all: mean")[2]) == pytest.approx(14.6, rel=0.2)
    assert made.series[0].y[0] > made.series[0].y[-1]
    assert made == liebe_18(STARS, 400, 2, _quiet)


def test_star_counts_are_skymaps() -> None:
    """Counts to V 5.49 within 3 %, to 7.49 within 8 %; the report's own narrow field seldom shows three stars."""
    made = moniteq_2_1(STARS, 500, 2, _quiet)
    for k, row in enumerate(made.rows[:10]):
        assert row[2] == pytest.approx(row[1], rel=0.2 if k < 3 else 0.08)
    assert _number(_row(made, "V 6.5, 3.45°")[2]) == pytest.approx(43, abs=8)
    crowded = _row(made, "V 5.5, 64 deg²: 0")
    assert _number(crowded[2]) > _number(crowded[1])


def test_the_walk_looks_at_fewer_than_the_documents_links() -> None:
    """45 stars of 3000 cost fewer looks than the document's 120, none missed."""
    made = moniteq_links(STARS, 40, 2, _quiet)
    assert _number(made.rows[3][2]) < 120
    assert [row[4] for row in made.rows] == [0, 0, 0, 0]


def test_locator_errors_are_the_reports_and_the_renderers() -> None:
    """Formula, paper and drawn spots agree to the last printed digit."""
    for row in moniteq_4_2(STARS, 1, 2, _quiet).rows[:12]:
        assert row[2] == pytest.approx(row[1], abs=1e-4)
        assert row[3] == pytest.approx(row[1], abs=1e-4)


def test_noise_figures_are_the_reports() -> None:
    """C's bound, its minima, and σ(P) of windows with every noise."""
    made = moniteq_noise(STARS, 5000, 2, _quiet)
    assert _row(made, "C, N 3, d/σ")[2] == pytest.approx(8.6, rel=0.02)
    for row in made.rows[-4:]:
        assert row[2] == pytest.approx(row[1], rel=0.01)
        assert float(str(row[3]).split()[1]) == pytest.approx(row[1], rel=0.04)


def test_angles_against_orbital_rate_are_the_reports() -> None:
    """Table 4.2's chain within 4 % for the 85 mm lens; the 50 mm reading is known not to follow."""
    made = moniteq_nea(STARS, 1, 2, _quiet)
    for row in made.rows:
        if "50 mm, low orbit: " not in str(row[0]) or "readings" in str(row[0]):
            assert row[2] == pytest.approx(row[1], rel=0.045)
    assert made.rows[4][3] is not None


def test_screening_experiment_is_listed_beside_the_document():
    """The table: figures of the document, the law and the counted values, reproducible with the seed."""
    stars = load_stars(8.0)
    made = moniteq_screening(stars, 500, 3, lambda _: None)
    assert made.rows == moniteq_screening(stars, 500, 3, lambda _: None).rows
    assert made.rows[0][1] == 0.17
    assert made.rows[0][2] == pytest.approx(0.17, rel=0.05)
