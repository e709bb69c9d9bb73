"""Success and failure of Sunsat's matching for five pairs of errors and tolerances (Jacobs 1995 §3.5, Tables 3-6 and 3-7)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gss.domain.camera import Camera
from gss.domain.experiment import Cell, Experiment, Progress, share_text
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.sunsat import calculate_attitude, match_stars
from gss.pipeline.chains.sunsat_match import SunsatCatalogue, prepare
from gss.pipeline.chains.sunsat_parameters import SunsatParameters, default_parameters
from validation.jacobs.catalogue import block_catalogue
from validation.jacobs.sky import (
    TABLE_3_5,
    Observed,
    bank_of,
    observe,
    random_attitude,
    sunsat_camera,
)

# Table 3-6: σp µrad, σMv, d_uncert µrad, Mv_uncert. Table 3-7: mean and largest time in seconds, failures with fewer
# than three stars, failures with three or more, wrong, success in %.
TABLE_3_6 = ((50, 0.3, 50, 0.3), (50, 0.3, 75, 0.45), (50, 0.3, 100, 0.6), (50, 0.3, 150, 0.6), (100, 0.3, 200, 0.45))
TABLE_3_7 = (
    (2.7, 6.2, 4, 177, 0, 81.9),
    (4.0, 15.0, 5, 17, 0, 97.8),
    (8.0, 39.0, 3, 9, 0, 98.8),
    (14.0, 60.0, 2, 4, 0, 99.4),
    (10.0, 73.0, 4, 24, 0, 97.2),
)
MIN_STARS = 3
# A total position error of σp corresponds to σp divided by this factor on each axis.
AXIS_FACTOR = float(np.sqrt(2.0))


@dataclass
class _Count:
    success: int = 0
    few: int = 0
    failed: int = 0
    wrong: int = 0
    entries: float = 0.0


def jacobs_3_7(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Match ``trials`` random attitudes for each row of Table 3-6."""
    camera = sunsat_camera()
    stars = block_catalogue(stars, (0.0, 120.0))
    catalogue = prepare(bank_of(stars, camera))
    rows: list[tuple[Cell, ...]] = []
    for k, (sigma_urad, sigma_mag, d_urad, mag) in enumerate(TABLE_3_6):
        base = replace(
            default_parameters(shipped_camera("sunsat")),
            distance_tolerance_rad=d_urad * 1e-6,
            magnitude_tolerance_mag=mag,
        )
        document, bound, per_axis = _Count(), _Count(), _Count()
        strict = replace(base, acceptance="document")
        rng = np.random.default_rng([seed, k])
        for trial in range(trials):
            progress((k + trial / trials) / len(TABLE_3_6))
            attitude = random_attitude(TABLE_3_5, rng)
            seen = observe(stars, camera, attitude, sigma_urad * 1e-6 / AXIS_FACTOR, sigma_mag, base, rng)
            _try(seen, camera, catalogue, strict, document)
            _try(seen, camera, catalogue, base, bound)
            worse = observe(stars, camera, attitude, sigma_urad * 1e-6, sigma_mag, base, rng)
            _try(worse, camera, catalogue, strict, per_axis)
        rows.append(_row(k, trials, document, bound, per_axis))
    progress(1.0)
    return Experiment(
        "jacobs-3-7",
        "Success of Sunsat's matching algorithm",
        "Jacobs 1995 §3.5, Tables 3-6 and 3-7",
        (
            "σ position µrad, σ mag; tolerances",
            "paper success %",
            "ours (95 %)",
            "paper failed < 3, ≥ 3 stars",
            "ours failed < 3, ≥ 3 stars",
            "paper wrong",
            "ours wrong",
            "with our bound (95 %)",
            "wrong with our bound",
            "document's test, σ on each axis (95 %)",
            "paper mean s",
            "ours mean table entries",
        ),
        tuple(rows),
        (
            f"{trials} random attitudes per row within Table 3-5; sub-catalogue of the whole 1° blocks in view: {len(stars)} "
            f"stars and {len(catalogue.guides.table)} pairs (paper 540 and 16 281); see jacobs-5-2",
            "the brightest eight stars of the catalogue in 11.17° x 8.32°, normal errors, no false stars, no distortion",
            "wrong: a group with a false match; the chain with the bound also tries the next eight stars and "
            "confirms with all stars in view",
        ),
        seed,
        (
            "The publication does not state whether σ applies to a position or to each of its axes. If it "
            "applies to a position, the distance of two stars has the same σ, which agrees with the text for the "
            "first row, and the figures agree. If it applies to each axis, the figures do not agree.",
            "The publication has no separate row for failures with exactly three stars. They count as failures "
            "with three or more.",
            "Three stars can match by chance. The published rule accepts such a group. The bound accepts it only if "
            "a match by chance is improbable.",
            "The times are those of a T800 processor. The time is proportional to the number of table entries read.",
        ),
    )


def _try(
    seen: Observed, camera: Camera, catalogue: SunsatCatalogue, parameters: SunsatParameters, count: _Count
) -> None:
    matching = match_stars(seen.centroids, camera, catalogue, parameters, Mode.LOST_IN_SPACE, None)
    count.entries += matching.operations
    named = matching.selected
    if parameters.acceptance == "bound" and not matching.reason:
        solution = calculate_attitude(matching, seen.centroids, camera, catalogue, parameters)
        named = named if solution.attitude is not None else named[:0]
    if len(named) == 0:
        few = len(seen.centroids) < MIN_STARS
        count.few += few
        count.failed += not few
    elif np.any(matching.row[named] != seen.row[named]):
        count.wrong += 1
    else:
        count.success += 1


def _row(k: int, trials: int, document: _Count, bound: _Count, per_axis: _Count) -> tuple[Cell, ...]:
    sigma_urad, sigma_mag, d_urad, mag = TABLE_3_6[k]
    mean_s, _, few, failed, wrong, success = TABLE_3_7[k]
    return (
        f"{sigma_urad}, {sigma_mag}; {d_urad}, {mag}",
        success,
        share_text(document.success, trials),
        f"{few:.0f}, {failed:.0f}",
        f"{document.few}, {document.failed}",
        int(wrong),
        document.wrong,
        share_text(bound.success, trials),
        bound.wrong,
        share_text(per_axis.success, trials),
        mean_s,
        document.entries / max(1, trials),
    )
