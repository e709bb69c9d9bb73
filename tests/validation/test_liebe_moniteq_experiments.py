"""Liebe's and Moniteq's tables with few trials: figures agree with the documents, and a seed determines a run."""

from __future__ import annotations

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.experiment import Experiment
from validation.liebe.key_numbers import liebe_4
from validation.liebe.sky import SITUATIONS, USED_STARS, catalogue, image, instrument
from validation.liebe.tables import liebe_2, liebe_3, liebe_18
from validation.moniteq.budgets import moniteq_2_3, moniteq_budgets
from validation.moniteq.differential import moniteq_differential
from validation.moniteq.locator import moniteq_4_2, moniteq_nea, moniteq_noise
from validation.moniteq.screening import moniteq_screening
from validation.moniteq.sky import moniteq_2_1, moniteq_links

STARS = load_stars(8.0)


def _no_progress(_: float) -> None:
    return None


def _number(cell: object) -> float:
    """Return the number at the start of a cell."""
    return float(str(cell).split()[0])


def _row(experiment: Experiment, prefix: str) -> tuple[object, ...]:
    """Return the first row whose label starts with a prefix."""
    return next(row for row in experiment.rows if str(row[0]).startswith(prefix))


def test_the_field_agrees_with_liebe() -> None:
    """1107 stars over the whole sky are 18.9 per field (Fig. 2), and the star list is as deep as the database requires."""
    camera = instrument().camera
    width, height = camera.fov_rad
    area_deg2 = 4 * np.degrees(np.degrees(np.arcsin(np.sin(width / 2) * np.sin(height / 2))))
    assert area_deg2 == pytest.approx(702.98, abs=1)
    assert USED_STARS * area_deg2 / 41_253 == pytest.approx(18.9, abs=0.1)
    assert len(catalogue(STARS)) == pytest.approx(1539, rel=0.05)


def test_images_have_the_stated_errors() -> None:
    """An image has the stated number of false stars, and the stated number of stars displaced by more than 3′."""
    bank, camera = catalogue(STARS), instrument().camera
    for situation in SITUATIONS:
        simulated = image(bank, camera, np.eye(3), situation, np.random.default_rng(3))
        is_star = simulated.row >= 0
        displacement_px = np.linalg.norm(
            simulated.centroids.pixels[is_star] - camera.project(bank.icrs[simulated.row[is_star]]), axis=1
        )
        assert np.count_nonzero(~is_star) == situation.false
        assert np.count_nonzero(displacement_px * camera.pixel_rad > np.radians(0.0501)) == situation.outside


def test_initial_estimates_succeed_as_often_as_in_the_document() -> None:
    """With fifty images per row, the row without errors is within 10 points of the document. The false-match bound
    loses at most 2 points, and no result is wrong.
    """
    progress: list[float] = []
    experiment = liebe_2(STARS, 50, 2, progress.append)
    assert abs(_number(experiment.rows[0][2]) - 94.6) < 10
    assert _number(experiment.rows[4][2]) < _number(experiment.rows[0][2])
    for row in experiment.rows:
        assert _number(row[4]) >= _number(row[2]) - 2
        assert row[5] == 0
    assert progress == sorted(progress)
    assert progress[-1] == 1.0


def test_predictional_estimates_are_as_accurate_as_in_the_document() -> None:
    """With forty images per row, the mean error is within 30 % of 14.6″ for stars inside 3′, and larger if every
    nearest star is used.
    """
    experiment = liebe_3(STARS, 40, 2, _no_progress)
    for row in experiment.rows:
        assert _number(row[3]) == pytest.approx(14.6, rel=0.3)
        assert _number(row[4]) >= 97
    assert _number(experiment.rows[3][2]) > 1.5 * _number(experiment.rows[3][3])


def test_boresight_error_decreases_with_the_root_of_stars() -> None:
    """Over four hundred estimates, σ_axis √n / σ_star is 1 within 10 %. The same seed gives the same run."""
    experiment = liebe_18(STARS, 400, 2, _no_progress)
    assert _number(_row(experiment, "all: rms")[2]) == pytest.approx(1.0, abs=0.1)
    assert _number(_row(experiment, "all: mean")[2]) == pytest.approx(14.6, rel=0.2)
    assert experiment.series[0].y[0] > experiment.series[0].y[-1]
    assert experiment == liebe_18(STARS, 400, 2, _no_progress)


def test_star_counts_agree_with_the_report() -> None:
    """Star counts agree with the report within 20 % in the first three rows and 8 % in the others. The report's narrow
    field seldom has three stars.
    """
    experiment = moniteq_2_1(STARS, 500, 2, _no_progress)
    for k, row in enumerate(experiment.rows[:10]):
        assert row[2] == pytest.approx(row[1], rel=0.2 if k < 3 else 0.08)
    assert _number(_row(experiment, "V 6.5, 3.45°")[2]) == pytest.approx(43, abs=8)
    crowded = _row(experiment, "V 5.5, 64 deg²: 0")
    assert _number(crowded[2]) > _number(crowded[1])


def test_the_walk_needs_fewer_comparisons_than_the_document() -> None:
    """A walk to 45 of 3000 stars needs fewer comparisons than the document's 120 and misses no star."""
    experiment = moniteq_links(STARS, 40, 2, _no_progress)
    assert _number(experiment.rows[3][2]) < 120
    assert [row[4] for row in experiment.rows] == [0, 0, 0, 0]


def test_locator_errors_agree_with_report_and_renderer() -> None:
    """The errors of the formula, of the report and of rendered spots agree to the last printed digit."""
    for row in moniteq_4_2(STARS, 1, 2, _no_progress).rows[:12]:
        assert row[2] == pytest.approx(row[1], abs=1e-4)
        assert row[3] == pytest.approx(row[1], abs=1e-4)


def test_noise_figures_agree_with_the_report() -> None:
    """The bound of C, its minima, and σ(P) of windows with all noise sources agree with the report."""
    experiment = moniteq_noise(STARS, 5000, 2, _no_progress)
    assert _row(experiment, "C, N 3, d/σ")[2] == pytest.approx(8.6, rel=0.02)
    for row in experiment.rows[-4:]:
        assert row[2] == pytest.approx(row[1], rel=0.01)
        assert float(str(row[3]).split()[1]) == pytest.approx(row[1], rel=0.04)


def test_angles_by_orbital_rate_agree_with_the_report() -> None:
    """Table 4.2 is reproduced within 4.5 %, except for the 50 mm lens in low orbit, for which the printed values do not
    follow from the report's model.
    """
    experiment = moniteq_nea(STARS, 1, 2, _no_progress)
    for row in experiment.rows:
        if "50 mm, low orbit: " not in str(row[0]) or "readings" in str(row[0]):
            assert row[2] == pytest.approx(row[1], rel=0.045)
    assert experiment.rows[4][3] is not None


def test_screening_experiment_agrees_with_the_document():
    """The table contains the document's figure of 0.17 and that of GSS, which agrees within 5 %. The same seed gives
    the same rows.
    """
    stars = load_stars(8.0)
    experiment = moniteq_screening(stars, 500, 3, lambda _: None)
    assert experiment.rows == moniteq_screening(stars, 500, 3, lambda _: None).rows
    assert experiment.rows[0][1] == 0.17
    assert experiment.rows[0][2] == pytest.approx(0.17, rel=0.05)


def test_averaged_estimates_and_database_agree_with_liebe() -> None:
    """The document's 185 000 entries lie between those without and with stars near the limit. The mean of fifty estimates
    is about seven times better than one (2.1″), and 200 estimates reach the document's 1″."""
    experiment = liebe_4(STARS, 2, 3, _no_progress)
    within, all_entries = _row(experiment, "entries in the database")[2], _row(experiment, "entries with the stars")[2]
    assert 0.85 * 185_000 < float(str(within)) < 185_000 < float(str(all_entries)) < 1.4 * 185_000
    means = {n: float(str(_row(experiment, f"mean of {n} ")[2])) for n in (1, 50, 200)}
    assert 0.6 < means[50] < 4.0
    assert means[200] < 1.5 < means[1] / 3


def test_star_densities_agree_with_moniteq() -> None:
    """From V 5 on, Hipparcos has the densities of Table 2.3 within a fifth, and they decrease towards the pole."""
    rows = {str(row[0]): row for row in moniteq_2_3(STARS, 1, 1, _no_progress).rows}
    for v_mag in (5, 6, 7):
        band = [rows[f"V {v_mag}, latitude {place}"] for place in ("0 to 5°", "15 to 25°", "60 to 90°")]
        ours = [float(str(row[2])) for row in band]
        assert ours == pytest.approx([float(str(row[1])) for row in band], rel=0.2)
        assert ours[0] > ours[1] > ours[2]


def test_budgets_of_moniteq_are_added_again() -> None:
    """Heat flows agree with Table 5.4. The entries of Tables 7.1 and 7.2 give other totals than those printed."""
    experiment = moniteq_budgets(STARS, 1, 1, _no_progress)
    for prefix, printed in (("Table 5.4: heat through the ceramic", 0.60), ("Table 5.4: heat through the leads", 0.14)):
        assert _row(experiment, prefix)[2] == pytest.approx(printed, abs=0.015)
    assert _row(experiment, "Table 7.1: attitude")[2] == _row(experiment, "Table 7.1: attitude")[1] == 2.37
    assert _row(experiment, "Table 7.1: image")[1:3] == (15.5, 15.2)
    assert _row(experiment, "Table 7.2: mass")[1:3] == (6000, 6090)
    assert _row(experiment, "Table 7.3: one pixel")[2] == pytest.approx(48.5, abs=0.05)


def test_a_differential_attitude_without_enough_stars_has_no_error() -> None:
    """If no attitude of a row has enough stars in view, the row has zero attitudes and no figures."""
    empty = [row for row in moniteq_differential(STARS, 1, 1, _no_progress).rows if row[-1] == 0]
    assert empty
    assert {cell for row in empty for cell in row[2:-1]} == {None}
