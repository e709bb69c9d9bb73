"""CubeStar's bank, frame times and power (Erlank 2013 §4.3.1, §5.3.2, §6.3, app. D)."""

from __future__ import annotations

import numpy as np

from gss.domain.experiment import Cell, Experiment, Progress
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_registry

LIMIT_MAG, PIXEL_RAD, REACH_RAD = 3.8, 0.00089, float(np.radians(42.0))
PAPER_STARS, PAPER_PAIRS = 405, 11_486
STAR_BYTES, PAIR_BYTES = 2 + 3 * 4, 2 + 2 + 4
# Table 6.2: mode, current in mA, time in ms of an iteration. The names are those of the simulated unit.
TABLE_6_2 = (("idle", 71.2, 140), ("starting", 121.2, 68), ("busy", 177.3, 388), ("copying", 81.81, 404))
SUPPLY_V, PAPER_MEAN_MW, PAPER_LARGEST_MW = 3.3, 396.2, 585.0
# Table D.2: register setting, measured frames per second, exposure in ms.
TABLE_D_2 = ((30, 11.110, 90), (9, 3.333, 300), (8, 2.966, 337), (7, 2.593, 386), (6, 2.224, 450))
SETTING_PER_FRAME = 2.7
CLOCK_HZ, ROW_CLOCKS, ROWS, PAPER_READOUT_MS = 10e6, 1322, 512, 67.69


def erlank_budgets(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Count the stars, pairs and bytes of the document's bank, and add its times and currents."""
    bank = stars.take(np.flatnonzero(stars.v_mag < LIMIT_MAG))
    distance_rad = _distances_rad(bank)
    first, second = np.nonzero(np.triu(distance_rad < PIXEL_RAD, 1))
    fainter = np.where(bank.v_mag[first] > bank.v_mag[second], first, second)
    bank = bank.take(np.setdiff1d(np.arange(len(bank)), fainter))
    separations = np.sort(_distances_rad(bank)[np.triu_indices(len(bank), 1)])
    pairs = int(np.searchsorted(separations, REACH_RAD, "right"))
    limit_deg = float(np.degrees(separations[PAPER_PAIRS - 1]))
    rows: list[tuple[Cell, ...]] = [
        (
            "§4.3.1: stars in the bank",
            PAPER_STARS,
            len(bank),
            f"Hipparcos V < 3.8 without {len(fainter)} less than a pixel from another",
        ),
        ("§4.3.1: closest pair, rad", 0.0017, round(float(separations[0]), 4), "µ Scorpii"),
        ("§4.3.1: next pair, rad", 0.0067, round(float(separations[1]), 4), "η and 27 Tauri"),
        ("§4.3.1: pairs in the bank", "11486, 11484 in §5.3.2", pairs, "pairs to 42.0°"),
        ("§4.3.1: limit that gives 11 486 pairs, °", "42 (Table 3.6)", round(limit_deg, 2), ""),
        ("§5.3.2: star list, kB", 5.54, round(len(bank) * STAR_BYTES / 1024, 2), "number of 2 bytes, three floats"),
        ("§5.3.2: distance list, kB", 89.7, round(pairs * PAIR_BYTES / 1024, 2), "two numbers of 2 bytes, a float"),
    ]
    current_ma, energy_mj = _unit_currents_ma(), 0.0
    for name, paper_ma, time_ms in TABLE_6_2:
        energy_mj += SUPPLY_V * current_ma[name] * time_ms / 1000
        rows.append((f"Table 6.2: {name}, mA", paper_ma, round(current_ma[name], 1), f"{time_ms} ms of 1000 ms"))
    largest = max(current_ma, key=lambda name: current_ma[name])
    rows += [
        ("eq. 6.3.1: mean power, mW", PAPER_MEAN_MW, round(energy_mj, 1), "currents of the simulated unit"),
        ("§6.3: largest power, mW", PAPER_LARGEST_MW, round(SUPPLY_V * current_ma[largest], 1), f"mode {largest}"),
    ]
    for setting, frames_s, exposure_ms in TABLE_D_2:
        rows.append(
            (
                f"Table D.2: setting {setting}, exposure ms",
                exposure_ms,
                round(1000 * SETTING_PER_FRAME / setting),
                f"{setting / SETTING_PER_FRAME:.3f} frames/s, measured {frames_s}",
            )
        )
    readout_ms = 1000 * ROWS * ROW_CLOCKS / CLOCK_HZ
    rows.append(("app. D: read-out of an image, ms", PAPER_READOUT_MS, round(readout_ms, 2), "512 rows of 1322 clocks"))
    progress(1.0)
    return Experiment(
        "erlank-budgets",
        "Bank, frame times and power of the unit",
        "Erlank 2013 §4.3.1, §5.3.2, §6.3, Table 6.2, Table D.2",
        ("quantity", "paper", "ours", "remark"),
        tuple(rows),
        (
            "bank: the two components of α Centauri are one star",
            "bytes: numbers of 2 bytes and floats of 4 bytes, which give the document's sizes",
        ),
        seed,
        (
            "The document limits pairs to 'the diagonal field of view', which is 60°. Its number of pairs needs a limit of about "
            "42°, the diameter of its circular field (Table 3.6). It prints 11 486 pairs in §4.3.1 and 11 484 in §5.3.2.",
            "The document states that mode 2 needs the largest power, 585 mW. Its Table 6.2 shows this current in mode 3.",
            "The exposure is the time between frames: a setting is 2.7 times the number of frames per second.",
        ),
    )


def _distances_rad(stars: StarTable) -> np.ndarray:
    """Return the (n, n) distances between the stars."""
    chord = np.linalg.norm(stars.icrs[:, None] - stars.icrs[None], axis=-1)
    return np.asarray(2 * np.arcsin(np.clip(chord / 2, 0, 1)))


def _unit_currents_ma() -> dict[str, float]:
    """Return the sum of the rails of the simulated unit in each mode of Table 6.2."""
    simulator = shipped_registry().get("cubestar").simulator
    if simulator is None:
        raise AssertionError("the shipped unit has no simulator.yaml")
    rails = (simulator.power.processor, simulator.power.imager, simulator.power.fpga, simulator.power.sram)
    return {
        "idle": sum(r.idle for r in rails) / 10,
        "starting": sum(r.idle if r.starting is None else r.starting for r in rails) / 10,
        "busy": sum(r.busy for r in rails) / 10,
        "copying": sum(r.idle if r.copying is None else r.copying for r in rails) / 10,
    }
