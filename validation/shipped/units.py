"""The five shipped units in factory state, each with its camera and defects, bank, chain and processing times."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from gss.catalogue_tools.onboard import decode
from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.experiment import Cell, Experiment, Progress, share_text
from gss.domain.results import Centroids, Outcome, SolveResult, Verdict
from gss.domain.rotation import quaternion_from_matrix, rotation_from_vector
from gss.domain.sensor import Defects
from gss.domain.stars import StarTable
from gss.instruments.golden import build_golden
from gss.instruments.package import Instrument
from gss.instruments.package_files import SimulatorFile
from gss.instruments.registry import shipped_registry
from gss.pipeline.chains.apriori import PriorState
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.onboard import Commanded, OnboardChain, Work
from gss.pipeline.chains.systems import system
from gss.pipeline.chip import make_chip
from gss.pipeline.render import render
from gss.pipeline.score import Score, assess
from validation.erlank.sky import random_attitude

FAINTER_MAG, DEEPEST_MAG = 2.5, 8.0
CHIP_SEED = 1
CYCLES_PER_FRAME = 0.2
STARTS = 5
# The axis is oblique, so stars cross the field and also rotate about its centre.
AXIS = np.array([0.6, 0.6, np.sqrt(0.28)])
SMEAR_PX = 0.88


@dataclass(frozen=True)
class DocumentedUnit:
    """Statements of a document about its unit. ``lost``, ``tracking``: success, accuracy and processing time, lost in
    space and in tracking. ``rates_deg_s``: rates in °/s up to the rate in the document. ``hint_deg``: largest error of
    the attitude with which the cycle starts; 0: the cycle starts lost in space. ``shortens``: True if the exposure is
    shortened until a star moves by ``SMEAR_PX`` (Moniteq 1983 §4.2)."""

    name: str
    lost: str
    tracking: str
    rates_deg_s: tuple[float, ...]
    hint_deg: float = 0.0
    shortens: bool = False


UNITS = (
    DocumentedUnit(
        "sunsat",
        "needs an estimate within 2°",
        "3 vectors where 3 stars appear; below 1 s",
        (0.0, 0.06, 0.12, 0.241),
        2.0,
    ),
    DocumentedUnit(
        "cubestar",
        "93 % of the sky; 320 ms at most; 26″ across",
        "100 % of the sky; 0.1333°/s shown, 0.3°/s expected",
        (0.0, 0.0635, 0.1333, 0.29),
    ),
    DocumentedUnit("far_mst", "100″ cross, 1080″ roll required", "LIST 1°/s, FAR-MST 10°/s", (0.0, 0.3, 1.0, 10.0)),
    DocumentedUnit("oersted", "94.6 %; 2 s; 0.1°", "100 %; 0.5 s; 15″", (0.0, 0.06, 0.2, 0.5)),
    DocumentedUnit(
        "aim", "too few stars in half of the fields", "0.5″ at rest for V 6", (0.0, 0.00417, 0.0417, 0.0667), 1.0, True
    ),
)


@dataclass
class _Tally:
    """Scores of the frames of one row. ``work_ms``: time of the unit's processor per frame."""

    frames: int = 0
    tracked: int = 0
    wrong: int = 0
    cross_rad: list[float] = field(default_factory=list)
    about_rad: list[float] = field(default_factory=list)
    work_ms: list[float] = field(default_factory=list)

    def add(self, scored: Score, mode: Mode, work_ms: float) -> None:
        self.frames += 1
        self.work_ms.append(work_ms)
        self.wrong += scored.verdict is Verdict.WRONG
        if scored.verdict is not Verdict.NONE:
            self.tracked += mode is Mode.TRACKING
            self.cross_rad.append(scored.cross_rad)
            self.about_rad.append(abs(scored.about_rad))


class ShippedUnit:
    """One unit with its factory bank and the tables that its processor computes."""

    def __init__(self, instrument: Instrument, stars: StarTable) -> None:
        self._instrument, self.profile = instrument, instrument.profile
        self.timing = (instrument.simulator or SimulatorFile()).timing
        self.chain: OnboardChain = system(self.profile.chain)
        capacity = instrument.catalogue.bank_bytes if instrument.catalogue else 0
        golden = build_golden(self.profile, capacity)
        bank = replace(decode(golden.image), hip=golden.hip)
        self.stars_on_board = len(bank)
        self._catalogue = self.chain.prepare(bank, self.profile)
        self._sky = stars.brighter_than(min(self.profile.sensor.faint_limit_mag + FAINTER_MAG, DEEPEST_MAG))
        self._chip = make_chip(self.profile.defects, self.profile.sensor, self.profile.camera, CHIP_SEED)

    def lost_in_space(self, frames: int, rng: np.random.Generator) -> _Tally:
        """Solve frames at rest at random attitudes without prior knowledge."""
        tally, still, exposure_s = _Tally(), np.zeros(3), self.profile.sensor.exposure_s
        for _ in range(frames):
            self._one(tally, random_attitude(rng), still, PriorState(), Mode.LOST_IN_SPACE, 0.0, exposure_s, rng)
        return tally

    def cycle(
        self, tally: _Tally, cycles: int, rate_rad_s: Array, documented: DocumentedUnit, rng: np.random.Generator
    ) -> None:
        """Run the unit's cycle at a constant rate. An iteration longer than the period takes a whole number of
        periods."""
        start, period_s = random_attitude(rng), self.timing.cycle_ms / 1000
        exposure_s = self.exposure_s(float(np.linalg.norm(rate_rad_s)), documented.shortens)
        prior, mode, time_s = PriorState(), Mode.LOST_IN_SPACE, 0.0
        if documented.hint_deg:
            radius_rad = float(np.radians(documented.hint_deg))
            axis = rng.normal(size=3)
            turn = rotation_from_vector(axis / np.linalg.norm(axis) * radius_rad * rng.random())
            prior = PriorState(commanded=quaternion_from_matrix(turn @ start), commanded_radius_rad=radius_rad)
            mode = Mode.ASSISTED
        for _ in range(cycles):
            attitude = rotation_from_vector(-rate_rad_s * time_s) @ start
            quaternion = self._one(tally, attitude, rate_rad_s, prior, mode, time_s, exposure_s, rng)
            prior, mode = prior.after(quaternion, time_s), self.chain.next_mode(mode, quaternion is not None)
            time_s += period_s * max(1.0, float(np.ceil(tally.work_ms[-1] / 1000 / period_s)))

    def _one(
        self,
        tally: _Tally,
        attitude: Array,
        rate_rad_s: Array,
        prior: PriorState,
        requested: Mode,
        time_s: float,
        exposure_s: float,
        rng: np.random.Generator,
    ) -> Array | None:
        """Render and process one frame. Returns the quaternion, None without a solution."""
        profile, chain = self.profile, self.chain
        frame = render(
            self._sky,
            profile.camera,
            profile.sensor,
            attitude,
            exposure_s,
            rng,
            rate_rad_s=rate_rad_s,
            chip=self._chip,
            defects=Defects(coupling_px=profile.defects.coupling_px),
        )
        mode = prior.usable(requested, time_s, chain.oldest_attitude_s)
        parameters = chain.parameters(profile, exposure_s, Commanded(hint_radius_rad=prior.radius_rad(mode)), mode)
        work = Work(profile.camera, self._catalogue, parameters, mode, prior.hint(mode, time_s), frame.dark)
        detection = chain.find_centroids(frame.pixels, work)
        matching = chain.match_stars(detection.centroids, work)
        solution = chain.calculate_attitude(matching, detection.centroids, work)
        work_ms = chain.detect_ms(frame.pixels.size, detection) + chain.match_ms(matching) + chain.attitude_ms(matching)
        outcome = Outcome.NONE if solution.attitude is None else Outcome.SOLVED
        centroids: Centroids = detection.centroids
        result = SolveResult(
            chain.name,
            outcome,
            solution.reason,
            profile.camera,
            (),
            centroids,
            solution.matches,
            solution.attitude,
            solution.false_match_probability,
        )
        tally.add(assess(result, frame.truth, profile.camera), mode, work_ms)
        return None if solution.attitude is None else np.asarray(solution.attitude.quaternion, float)

    def exposure_s(self, rate_rad_s: float, shortens: bool) -> float:
        """Return the unit's exposure at a rate."""
        sensor = self.profile.sensor
        if not shortens or rate_rad_s == 0:
            return sensor.exposure_s
        longest_s = SMEAR_PX * self.profile.camera.pixel_rad / rate_rad_s
        return float(np.clip(longest_s, sensor.exposure_min_s, sensor.exposure_s))


def shipped_units(
    stars: StarTable, trials: int, seed: int, progress: Progress, units: tuple[DocumentedUnit, ...] = UNITS
) -> Experiment:
    """Measure every unit as shipped. ``trials``: lost-in-space frames per unit. The number of cycles per rate is a
    fifth of it."""
    cycles, rows = max(1, round(CYCLES_PER_FRAME * trials / STARTS)), []
    for k, documented in enumerate(units):
        unit = ShippedUnit(shipped_registry().get(documented.name), stars)
        rng = np.random.default_rng([seed, k])
        tally = unit.lost_in_space(trials, rng)
        title = f"{documented.name}, lost in space, {unit.stars_on_board} stars on board"
        rows.append(_row(title, documented.lost, tally))
        for j, rate_deg_s in enumerate(documented.rates_deg_s):
            progress((k + (1 + j) / (1 + len(documented.rates_deg_s))) / len(units))
            tally, rng = _Tally(), np.random.default_rng([seed, k, j])
            for _ in range(STARTS):
                unit.cycle(tally, cycles, float(np.radians(rate_deg_s)) * AXIS, documented, rng)
            rows.append(_row(f"{documented.name}, cycle at {rate_deg_s:g}°/s", documented.tracking, tally))
    progress(1.0)
    return Experiment(
        "shipped-units",
        "The five units as shipped",
        "Jacobs 1995, Erlank 2013, Huffman 2006, Liebe 1992, Moniteq 1983",
        (
            "unit",
            "paper",
            "frames with an attitude (95 %)",
            "in tracking",
            "wrong",
            "error across, median ″",
            "error across, 95 %, ″",
            "error about, median ″",
            "processor, mean ms",
        ),
        tuple(rows),
        (
            f"per unit {trials} frames at random attitudes at rest, and at each rate {STARTS} runs of {cycles} cycles, each from a "
            "random attitude, about an axis oblique to the boresight",
            "the cycle starts lost in space, except for Sunsat, which starts from an attitude with an error of "
            "up to 2° (Jacobs 1995 §3.5), and AIM, which starts from an attitude of its inertial system with an "
            "error of up to 1°",
            "camera, exposure, defects, period, chain and its constants, and the factory bank of the whole sky as shipped; stars "
            f"{FAINTER_MAG} mag beyond the camera's limit, V {DEEPEST_MAG:g} at most; with smear, without planets "
            "and stray light",
            f"AIM: the exposure is shortened until a star moves {SMEAR_PX} px",
            "processor: times from the documents, scaled with the number of operations; not times of this computer",
        ),
        seed,
        (
            "Wrong: a false match in the solution, or a boresight error of more than 5 px. The number of wrong "
            "results must be 0.",
            "In its document, Sunsat matches with the stars that its orbit can show, from an attitude accurate "
            "to 2°. The factory bank contains the brightest stars of the whole sky. Without an attitude at "
            "power-on, most fields are too ambiguous for its matching. In its document, AIM has fewer than three "
            "usable stars in half of the fields of the whole sky. The chain requires four stars without an "
            "attitude and three with one.",
            "At 10°/s, FAR-MST's exposure of 0.1 s smears a star over 42 px. The numbers in its document would "
            "require an exposure of about 20 ms.",
        ),
    )


def _row(title: str, paper: str, tally: _Tally) -> tuple[Cell, ...]:
    cross = np.array(tally.cross_rad) / ARCSEC_RAD
    about = np.array(tally.about_rad) / ARCSEC_RAD
    solved = len(cross) > 0
    return (
        title,
        paper,
        share_text(len(cross), tally.frames),
        tally.tracked,
        tally.wrong,
        round(float(np.median(cross)), 1) if solved else None,
        round(float(np.percentile(cross, 95)), 1) if solved else None,
        round(float(np.median(about)), 1) if solved else None,
        round(float(np.mean(tally.work_ms))),
    )
