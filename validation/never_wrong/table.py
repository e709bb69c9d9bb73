"""The "never wrong" campaign: every chain with its camera under every fault, with each result compared with the truth."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

from gss.domain.experiment import Cell, Experiment, Progress, share_interval
from gss.domain.results import Verdict
from gss.domain.stars import StarTable
from gss.pipeline.chains.modes import Mode
from gss.pipeline.score import Score, assess
from validation.never_wrong.faults import FAULTS, Fault, attitude_at
from validation.never_wrong.sky import SETTINGS, Subject, prior, shown, subject

MODES = tuple(Mode)
MAX_NAMED = 12
Key = tuple[int, int, int, int]


@dataclass
class _Cell:
    """Results of one chain, fault and mode: verdicts, number of wrong results with a false match, and a text for every wrong
    result."""

    counts: Counter[Verdict] = field(default_factory=Counter)
    false_names: int = 0
    named: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        """Return the counts as correct/imprecise/wrong/none."""
        order = (Verdict.CORRECT, Verdict.IMPRECISE, Verdict.WRONG, Verdict.NONE)
        return "/".join(str(self.counts[v]) for v in order)


def never_wrong(
    stars: StarTable, trials: int, seed: int, progress: Progress, chains: tuple[str, ...] = ()
) -> Experiment:
    """Count correct, imprecise, wrong and missing results of each chain under each fault.

    ``trials``: random attitudes per chain, fault and mode. ``chains``: chains to test, all if empty. A wrong result is
    listed with the values that reproduce it."""
    rows: list[tuple[Cell, ...]] = []
    cells: list[_Cell] = []
    for i, setting in enumerate(SETTINGS):
        if chains and setting.chain not in chains:
            continue
        system = subject(setting, stars)
        for j, fault in enumerate(FAULTS):
            progress((i + j / len(FAULTS)) / len(SETTINGS))
            made = [_cell(system, fault, (seed, i, j, k), trials) for k in range(len(MODES))]
            wrong, false_names = sum(c.counts[Verdict.WRONG] for c in made), sum(c.false_names for c in made)
            rows.append((f"{setting.chain}, {fault.title}", *(c.text for c in made), wrong, false_names))
            cells += made
    progress(1.0)
    return Experiment(
        "never-wrong",
        "False attitudes under every fault",
        "requirement of GSS; Jacobs 1995 Table 3-7 and Erlank 2013 §4.3.5 report no false attitude",
        (
            "chain, fault",
            *(f"{m.value.replace('_', ' ')}: correct/imprecise/wrong/none" for m in MODES),
            "wrong (required 0)",
            "of these with a false match",
        ),
        tuple(rows),
        (_sum(cells, trials), *_conditions()),
        seed,
        _notes(cells),
    )


def _sum(cells: list[_Cell], trials: int) -> str:
    wrong = sum(c.counts[Verdict.WRONG] for c in cells)
    trials_run = sum(c.counts.total() for c in cells)
    answers = trials_run - sum(c.counts[Verdict.NONE] for c in cells)
    most = 100 * share_interval(wrong, answers)[1]
    return (
        f"{trials} random attitudes per chain, fault and mode, a quarter of them for the reference, fewer for "
        "faults that require a search of the whole sky: "
        f"{trials_run} lists, {answers} answers, {wrong} wrong; upper limit (95 %) for the same "
        f"mixture of cases: {most:.2g} % of the answers"
    )


def _notes(cells: list[_Cell]) -> tuple[str, ...]:
    named = [text for c in cells for text in c.named]
    more = len(named) - MAX_NAMED
    return (
        "Correct: cross-boresight error within three of its standard deviations, all matches correct. Wrong: a false "
        "match in the attitude, or an error of more than five pixels; for a mirrored list, any solution.",
        "If the true focal length differs and a few stars in a corner are matched, the matches are correct but "
        "the boresight has an error: the scale error times the distance of these stars from the centre, 1 % of "
        "600 px. Such a result counts as wrong.",
        *(named[:MAX_NAMED] or ["No wrong result in this run."]),
        *([f"and {more} more wrong results"] if more > 0 else []),
    )


def _conditions() -> tuple[str, ...]:
    described = "; ".join(
        f"{s.chain}: camera {s.camera}, bank V ≤ {s.bank_mag}, measures stars to V {s.seen_mag}, {s.noise_px} px, {s.noise_mag} mag"
        for s in SETTINGS
    )
    return (
        described,
        "lists of centroids with normally distributed errors; each list contains every star measured brighter "
        "than the limit, including stars that are not in the bank; false stars uniform over the detector",
        "assisted and tracking: a prior attitude with an error of up to "
        + ", ".join(f"{np.degrees(s.assisted_rad):.0f}°/{np.degrees(s.tracking_rad):.2g}°" for s in SETTINGS)
        + " in the chains' order, about any axis",
    )


def _cell(subject: Subject, fault: Fault, key: Key, trials: int) -> _Cell:
    """Return the verdicts of one chain, fault and mode; trial t uses the generator seeded with (*key, t)."""
    cell = _Cell()
    for trial in range(max(1, round(subject.setting.share * fault.share * trials))):
        judged = judge(subject, fault, key, trial)
        cell.counts[judged.verdict] += 1
        if judged.verdict is Verdict.WRONG:
            cell.false_names += judged.false_matches > 0
            cell.named.append(_named(subject, fault, (*key, trial), judged))
    return cell


def _named(subject: Subject, fault: Fault, key: tuple[int, ...], judged: Score) -> str:
    off_px = judged.cross_rad / subject.camera.pixel_rad
    return (
        f"WRONG: {subject.setting.chain}, {fault.title}, {MODES[key[3]].value}: {judged.false_matches} false of "
        f"{judged.false_matches + judged.matched} matches, boresight error {off_px:.1f} px; generator {list(key)}"
    )


def judge(subject: Subject, fault: Fault, key: Key, trial: int) -> Score:
    """Score one trial. The seed, the indices of chain, fault and mode, and the trial number identify it."""
    return judge_with(subject, fault, MODES[key[3]], np.random.default_rng([*key, trial]))


def judge_with(subject: Subject, fault: Fault, mode: Mode, rng: np.random.Generator) -> Score:
    """Score one trial of a chain: draw attitude, centroid list and prior from ``rng``, and compare the result with the truth."""
    attitude = attitude_at(fault.place, subject.camera, rng)
    made = shown(subject, fault, attitude, rng)
    result = subject.solve(made.centroids, mode, prior(subject.setting, mode, attitude, rng))
    judged = assess(result, made.truth_for(result), subject.camera)
    if fault.mirrored and result.attitude is not None:
        return replace(judged, verdict=Verdict.WRONG)
    return judged
