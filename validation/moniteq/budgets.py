"""Moniteq's star density by galactic latitude, and the budgets of heat, power and mass (Moniteq 1983 §2.1, §5.3, §7)."""

from __future__ import annotations

import numpy as np

from gss.domain.angles import unit_from_ra_dec
from gss.domain.experiment import Cell, Experiment, Progress
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from validation.moniteq.sky import WHOLE_SKY_DEG2

# Table 2.3: limit of V, density per square degree at galactic latitudes 0°, 20° and 90°.
TABLE_2_3 = (
    (3, (0.004, 0.004, 0.003)),
    (4, (0.014, 0.013, 0.010)),
    (5, (0.054, 0.047, 0.034)),
    (6, (0.191, 0.161, 0.102)),
    (7, (0.652, 0.520, 0.290)),
)
BANDS_DEG = ((0.0, 5.0), (15.0, 25.0), (60.0, 90.0))
GALACTIC_POLE = (np.radians(192.85948), np.radians(27.12825))  # ICRS, Hipparcos catalogue vol. 1, §1.5.3

# Table 5.4: heat transfer in K/W (None: not stated) and printed heat flow in W between the sink at 65 °C and the chip at −5 °C.
THERMAL = (("ceramic flange", 114.0, 0.60), ("leads", 500.0, 0.14), ("radiation", None, 0.24), ("chip", None, 0.10))
HOT_C, COLD_C = 65.0, -5.0
LEADS, LEAD_CM, LEAD_CM2, COPPER_W_CM_K = 30, 2.5, 0.08 * 0.013, 4.0
# Table 7.1 in W: image controller of a camera, attitude image monitor; printed totals.
CONTROLLER_W = (0.10, 0.30, 0.50, 0.75, 0.10, 0.10, 0.10, 0.80, 0.10, 0.20, 0.05, 2.00, 10.00, 0.10)
MONITOR_W = (1.50, 0.20, 0.40, 0.05, 0.02, 0.10, 0.10)
PAPER_CONTROLLER_W, PAPER_MONITOR_W, PAPER_SUPPLY_W, CONVERTER = 15.50, 2.37, 23.0, 0.80
MASSES_G = (600, 370, 10, 100, 10, 700, 2500, 100, 1200, 500)
PAPER_MASS_G = 6000
CATALOGUE_STARS, CATALOGUE_KB = 3000, 70


def moniteq_2_3(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Count the stars in bands of galactic latitude in both hemispheres."""
    pole = unit_from_ra_dec(*GALACTIC_POLE)
    latitude_deg = np.degrees(np.arcsin(np.clip(stars.icrs @ pole, -1, 1)))
    rows: list[tuple[Cell, ...]] = []
    for v_mag, paper in TABLE_2_3:
        for (low, high), density in zip(BANDS_DEG, paper, strict=True):
            inside = (np.abs(latitude_deg) >= low) & (np.abs(latitude_deg) < high) & (stars.v_mag <= v_mag)
            count = int(np.count_nonzero(inside))
            area_deg2 = WHOLE_SKY_DEG2 * float(np.sin(np.radians(high)) - np.sin(np.radians(low)))
            rows.append((f"V {v_mag}, latitude {low:g} to {high:g}°", density, round(count / area_deg2, 4), count))
    progress(1.0)
    return Experiment(
        "moniteq-2-3",
        "Star density by galactic latitude",
        "Moniteq 1983 §2.1, Table 2.3",
        ("limit and band", "paper, stars per square degree", "ours", "stars counted"),
        tuple(rows),
        (
            "Hipparcos V, positions at the catalogue epoch; bands in both hemispheres",
            "paper: latitudes 0°, 20° and 90°, from a publication of 1924",
        ),
        seed,
        (
            "The report states that its densities do not agree exactly with modern magnitudes. From V 5 on they agree within a "
            "fifth. Near the Milky Way Hipparcos has nearly twice as many stars to V 3, and a third more to V 4.",
            "The density at V 8 is omitted: Hipparcos is complete to V 7.3 only.",
        ),
    )


def moniteq_budgets(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Add the entries of the heat, power and mass tables and compare them with the printed totals."""
    across_k = HOT_C - COLD_C
    leads_k_w = LEAD_CM / (COPPER_W_CM_K * LEAD_CM2) / LEADS
    controller_w, monitor_w = sum(CONTROLLER_W), sum(MONITOR_W)
    supply_w = (controller_w + monitor_w) / CONVERTER
    flange_w, series_w = (across_k / float(k) for _, k, _ in THERMAL[:2] if k is not None)
    camera = shipped_camera("aim").camera
    rows: list[tuple[Cell, ...]] = [
        ("Table 5.4: heat through the ceramic flange, W", 0.60, round(flange_w, 3), "70 K over 114 K/W"),
        ("Table 5.4: heat through the leads, W", 0.14, round(series_w, 3), "70 K over 500 K/W"),
        ("Table 5.4: 30 copper leads, K/W", 23, round(leads_k_w, 1), "2.5 cm of 0.08 x 0.013 cm, 4 W/(cm K)"),
        (
            "Table 5.4: heat load of the cooler, W",
            None,
            round(flange_w + series_w + sum(w for _, k, w in THERMAL if k is None), 2),
            "sum with the printed radiation and dissipation",
        ),
        (
            "Table 7.1: image controller, W",
            PAPER_CONTROLLER_W,
            round(controller_w, 2),
            "the entries do not add up to the printed total",
        ),
        ("Table 7.1: attitude image monitor, W", PAPER_MONITOR_W, round(monitor_w, 2), ""),
        ("Table 7.3: power of a camera with monitor, W", PAPER_SUPPLY_W, round(supply_w, 1), "converter of 80 %"),
        (
            "Table 7.2: mass of a camera, g",
            PAPER_MASS_G,
            sum(MASSES_G),
            "the entries do not add up to the printed total",
        ),
        ("Table 7.3: one pixel, ″", 48.5, round(float(np.degrees(camera.pixel_rad)) * 3600, 2), "20 µm, 85 mm"),
        ("Table 7.3: field of view, °", 3.45, round(float(np.degrees(camera.fov_rad[0])), 3), "256 px"),
        (
            "Table 7.3: bytes per star of the catalogue",
            None,
            round(1000 * CATALOGUE_KB / CATALOGUE_STARS, 1),
            "3000 stars in 70 kbyte",
        ),
        ("Table 7.3: stars to V 6", CATALOGUE_STARS, int(np.count_nonzero(stars.v_mag <= 6.0)), "Hipparcos, whole sky"),
    ]
    progress(1.0)
    return Experiment(
        "moniteq-budgets",
        "Budgets of heat, power and mass",
        "Moniteq 1983 §5.3 and §7, Tables 5.4 and 7.1 to 7.3",
        ("quantity", "paper", "ours", "remark"),
        tuple(rows),
        ("sums of the printed entries; camera of the shipped unit",),
        seed,
        (
            "The entries of Table 7.1 add up to 15.2 W, those of Table 7.2 to 6.09 kg. The printed totals are 15.5 W and 6 kg. "
            "With a converter of 80 %, a camera with its monitor needs 22.0 W (22.3 W from the printed total); the report "
            "prints 23 W.",
            "The catalogue of 3000 stars contains three fifths of the stars to V 6. The report does not state how they are "
            "selected.",
            "Figs. 5.4 to 5.6 (shade, cooler) are missing from the text, so the power of the cooler cannot be computed again.",
        ),
    )
