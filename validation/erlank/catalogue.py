"""Erlank's sky coverage tables, computed with Hipparcos."""

from __future__ import annotations

import numpy as np

from gss.catalogue_tools.envelope.field import CircularField
from gss.domain.experiment import Cell, Curve, Experiment, Progress, share_text
from gss.domain.stars import StarTable
from validation.jacobs.catalogue import random_counts

ERLANK_3_6 = (
    (3.0, 84.04, 52.61, 5.71),
    (3.2, 90.51, 68.81, 7.04),
    (3.4, 93.71, 82.52, 8.55),
    (3.6, 99.15, 91.92, 10.61),
    (3.8, 99.92, 98.92, 13.52),
    (4.0, 100.0, 99.61, 17.10),
)
FIG_3_8_FIELDS_DEG = (10, 15, 20, 25, 30, 35, 40, 45, 50)
FIG_3_8_LIMITS_MAG = (3.0, 3.5, 4.0, 4.5, 5.0, 5.5)


def erlank_3_6(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Count stars as a function of the limiting magnitude (Erlank 2013 Table 3.6)."""
    shape = CircularField(float(np.radians(21.0)))
    rows: list[tuple[Cell, ...]] = []
    for k, (limit, three, five, mean) in enumerate(ERLANK_3_6):
        progress(k / len(ERLANK_3_6))
        counts = random_counts(stars.brighter_than(limit).icrs, shape, trials, seed + k)
        ours3, ours5 = int((counts >= 3).sum()), int((counts >= 5).sum())
        rows += [
            (f"V ≤ {limit}: at least 3 stars, %", three, round(100 * ours3 / trials, 2), share_text(ours3, trials)),
            (f"V ≤ {limit}: at least 5 stars, %", five, round(100 * ours5 / trials, 2), share_text(ours5, trials)),
            (f"V ≤ {limit}: mean stars", mean, round(float(counts.mean()), 2), ""),
        ]
    conditions = (f"{trials} pointings per limit, circular field, 42° in diameter", "Hipparcos V")
    notes = (
        "The caption states a radius of 42° and two stars. Text and figures agree with a diameter of 42° and three stars (errata).",
    )
    columns = ("quantity", "paper", "ours", "95 % interval")
    return Experiment(
        "erlank-3-6",
        "Sky coverage against limiting magnitude",
        "Erlank 2013 Table 3.6",
        columns,
        tuple(rows),
        conditions,
        seed,
        notes,
    )


def erlank_fig_3_8(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Compute the fraction of the sky with at least three stars, by field and limiting magnitude (Erlank 2013 Fig.
    3.8)."""
    rows: list[tuple[Cell, ...]] = []
    curves = []
    for k, limit in enumerate(FIG_3_8_LIMITS_MAG):
        unit = stars.brighter_than(limit).icrs
        shares = []
        for field_deg in FIG_3_8_FIELDS_DEG:
            counts = random_counts(unit, CircularField(float(np.radians(field_deg / 2))), trials, seed)
            covered = int((counts >= 3).sum())
            shares.append(covered / trials)
            in_document = (field_deg, limit) == (20, 5.0)
            rows.append(
                (f"V ≤ {limit}, field {field_deg}°", "close to 1" if in_document else None, round(shares[-1], 4), "")
            )
        fields = tuple(map(float, FIG_3_8_FIELDS_DEG))
        curves.append(Curve(f"V ≤ {limit}", "diameter of the field, °", "share of the sky", fields, tuple(shares)))
        progress((k + 1) / len(FIG_3_8_LIMITS_MAG))
    conditions = (f"{trials} pointings per point, circular fields", "at least three stars, Hipparcos V")
    notes = (
        "The figure's curves have no numbers. According to the text, the curve for magnitude five approaches 1 at 20°.",
    )
    columns = ("case", "paper", "ours", "remark")
    return Experiment(
        "erlank-fig-3-8",
        "Sky coverage by field and magnitude",
        "Erlank 2013 Fig. 3.8",
        columns,
        tuple(rows),
        conditions,
        seed,
        notes,
        tuple(curves),
    )
