"""Report of one chain on the stored frames: success rate, errors and failures, compared with another chain."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import ARCSEC_RAD
from gss.domain.errors import NotFound
from gss.domain.experiment import share_interval, share_text
from gss.domain.frames import (
    AGREE_ABOUT_RAD,
    AGREE_CROSS_RAD,
    attitudes_agree,
    pointing_difference_rad,
    ra_dec_roll_rad,
)
from gss.domain.rotation import matrix_from_quaternion
from gss.domain.words import counted
from gss.operations.report.parts import Fact, Note, Plot, Report, Section, Series, Table
from gss.store import frames as store
from gss.store.engine import Database
from gss.store.frames import ChainKey, FrameRun

MAX_FRAMES = 20_000
"""Maximum number of frames in a report; the latest frames are used."""
MAX_FAILURES = 500
GROUND_RESULT = "the operational ground result"
MAX_BINS = 24


@dataclass(frozen=True)
class Failure:
    """A frame without a solution, or with a solution that is wrong or differs from that of the other chain. ``kind``:
    no solution, wrong or differs."""

    frame_id: int
    kind: str
    reason: str


@dataclass(frozen=True)
class ChainReport:
    """A report with its failures. ``failures``: at most ``MAX_FAILURES``, oldest frame first; ``failed``: number of all
    failures."""

    report: Report
    failures: tuple[Failure, ...]
    failed: int


def name_of(key: ChainKey) -> str:
    """Return a chain with its version and changed constants, for titles."""
    return f"{key.chain} {key.version}" + (f" ({key.options})" if key.options else "")


class ChainReports:
    """Computes reports from stored results. Only the latest result of each frame counts."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def report(self, key: ChainKey, against: ChainKey | None = None) -> ChainReport:
        """Return the report of a chain compared with another chain, or with each frame's operational result if
        ``against`` is None. Raises NotFound if one of the chains has no results."""
        with self._database.unit_of_work() as session:
            own_runs = store.runs_of(session, key, MAX_FRAMES)
            ids = [run.frame_id for run in own_runs]
            other_runs = (
                store.operational_runs(session, ids) if against is None else store.runs_of(session, against, MAX_FRAMES)
            )
        for run_key, runs in ((key, own_runs), (against, other_runs)):
            if run_key is not None and not runs:
                raise NotFound("no result of this chain on a stored frame", got=name_of(run_key))
        other_by_frame = {run.frame_id: run for run in other_runs}
        compared = GROUND_RESULT if against is None else name_of(against)
        judged = [_judged(run, other_by_frame.get(run.frame_id)) for run in own_runs]
        failures = [
            failure for run, state in zip(own_runs, judged, strict=True) if (failure := _failure(run, state, compared))
        ]
        sections = [
            _summary(own_runs),
            _comparison(judged, compared),
            Section("Errors", drawings=[p for p in (_errors(own_runs), _differences(judged, compared)) if p]),
            Section("When and where", drawings=[_over_time(own_runs), _over_sky(own_runs, other_by_frame)]),
            _reasons(own_runs),
        ]
        notes = [Note(f"Only the latest {MAX_FRAMES} frames are covered.")] if len(own_runs) == MAX_FRAMES else []
        days = dict.fromkeys(f"{run.taken:%Y-%m-%d}" for run in (own_runs[0], own_runs[-1]))
        subtitle = f"{counted(len(own_runs), 'frame')}, {' to '.join(days)}, against {compared}"
        return ChainReport(
            Report(
                f"Chain {name_of(key)}", subtitle, [s for s in sections if s.facts or s.drawings or s.tables], notes
            ),
            tuple(failures[:MAX_FAILURES]),
            len(failures),
        )


@dataclass(frozen=True)
class _Judged:
    """Result of a frame compared with the other chain. ``state``: agrees, differs, none (no solution of the other
    chain) or missing (the other chain was not run); ``cross_rad``, ``about_rad``: difference of the attitudes, NaN if
    an attitude is missing."""

    solved: bool
    state: str
    cross_rad: float
    about_rad: float


def _judged(run: FrameRun, other: FrameRun | None) -> _Judged:
    no_angle = float("nan")
    if other is None:
        return _Judged(run.solved, "missing", no_angle, no_angle)
    if not other.solved:
        return _Judged(run.solved, "none", no_angle, no_angle)
    if not run.solved:
        return _Judged(False, "agrees", no_angle, no_angle)
    cross_rad, about_rad = pointing_difference_rad(_matrix(run), _matrix(other))
    return _Judged(True, "agrees" if attitudes_agree(cross_rad, about_rad) else "differs", cross_rad, about_rad)


def _failure(run: FrameRun, judged: _Judged, compared: str) -> Failure | None:
    if not run.solved:
        return Failure(run.frame_id, "no solution", run.reason)
    if run.verdict == "wrong":
        return Failure(run.frame_id, "wrong", "the attitude differs from that of the simulated sky")
    if judged.state == "differs":
        cross, about = judged.cross_rad / ARCSEC_RAD, judged.about_rad / ARCSEC_RAD
        return Failure(run.frame_id, "differs", f"{cross:.0f}″ across and {about:.0f}″ about the axis from {compared}")
    return None


def _summary(runs: Sequence[FrameRun]) -> Section:
    solved = [run for run in runs if run.solved]
    judged = [run for run in runs if run.verdict not in (None, "none")]
    wrong = sum(run.verdict == "wrong" for run in judged)
    facts = [Fact("Frames", str(len(runs))), Fact("Solved", share_text(len(solved), len(runs)), note="95 % interval")]
    if judged:
        upper_limit = 100 * share_interval(wrong, len(judged))[1]
        facts.append(Fact("Wrong", f"{wrong} of {len(judged)}", note=f"at most {upper_limit:.1f} % (95 %)"))
    for label, unit, value in (
        ("Median error of the axis", "″", [_arcsec(run.error_axis_rad) for run in solved]),
        ("Median residual", "px", [run.rms_px for run in solved]),
        ("Median time", "ms", [1e3 * sum(run.timing_s.values()) if run.timing_s else None for run in solved]),
    ):
        numbers = [v for v in value if v is not None]
        if numbers:
            facts.append(Fact(label, f"{float(np.median(numbers)):.3g}", unit, counted(len(numbers), "frame")))
    return Section("Summary", facts=facts)


def _comparison(judged: Sequence[_Judged], compared: str) -> Section:
    columns = ("agrees", "differs", "none", "missing")
    rows = []
    for label, solved in (("Solved", True), ("No solution", False)):
        counts = [sum(j.solved is solved and j.state == state for j in judged) for state in columns]
        cells = [str(n) for n in counts] if solved else [str(counts[0]), "–", *(str(n) for n in counts[2:])]
        rows.append([label, *cells])
    column_titles = ["This chain", "solved, agrees", "solved, differs", "no solution", "not run"]
    text = (
        f"Columns: {compared}. Attitudes agree if they differ by less than {AGREE_CROSS_RAD / ARCSEC_RAD:.0f}″ across and "
        f"{AGREE_ABOUT_RAD / ARCSEC_RAD:.0f}″ about the axis. A frame that only the other chain solved counts in the first column."
    )
    return Section(
        "Against the other result", text, tables=[Table(f"Frames by result, {compared}", column_titles, rows)]
    )


def _errors(runs: Sequence[FrameRun]) -> Plot | None:
    errors = [_arcsec(run.error_axis_rad) for run in runs if run.solved]
    return _histogram("Error of the axis against the simulated sky", [v for v in errors if v is not None])


def _differences(judged: Sequence[_Judged], compared: str) -> Plot | None:
    cross = [j.cross_rad / ARCSEC_RAD for j in judged if np.isfinite(j.cross_rad)]
    return _histogram(f"Difference across the axis from {compared}", cross)


def _histogram(title: str, values: Sequence[float]) -> Plot | None:
    """Return a histogram with logarithmic bins. Differences below a thousandth of an arcsecond are counted in the first
    bin."""
    if not values:
        return None
    clipped = np.clip(values, 1e-3, None)
    bins = min(MAX_BINS, 2 + 2 * round(len(values) ** 0.5))
    edges = np.geomspace(float(clipped.min()) / 1.5, float(clipped.max()) * 1.5, bins + 1)
    counts, _ = np.histogram(clipped, edges)
    series = Series("frames", [float(e) for e in edges], [float(n) for n in counts], "bars")
    return Plot(title, "arcseconds", "frames", [series], log_x=True)


def _over_time(runs: Sequence[FrameRun]) -> Plot:
    seconds = np.array([run.taken.replace(tzinfo=run.taken.tzinfo or UTC).timestamp() for run in runs])
    solved = np.array([run.solved for run in runs])
    edges = np.linspace(seconds.min(), max(seconds.max(), seconds.min() + 1) + 1, MAX_BINS + 1)
    frames, _ = np.histogram(seconds, edges)
    hits, _ = np.histogram(seconds[solved], edges)
    share = [100 * float(h) / float(n) if n else None for h, n in zip(hits, frames, strict=True)]
    return Plot(
        "Solved over time",
        "UTC",
        "%",
        [Series("solved", [float(e) for e in edges], share, "bars")],
        time=True,
    )


def _over_sky(runs: Sequence[FrameRun], other_by_frame: Mapping[int, FrameRun]) -> Plot:
    """Plot the boresights of the frames. For a frame without a solution, the boresight of the other result is
    plotted."""
    attitude_runs = [(run.solved, run if run.solved else other_by_frame.get(run.frame_id)) for run in runs]

    def dots(label: str, select: Callable[[bool], bool]) -> Series:
        positions = [_ra_dec_deg(o) for solved, o in attitude_runs if select(solved) and o is not None and o.solved]
        return Series(label, [a for a, _ in positions], [d for _, d in positions], "dots")

    series = [dots("solved", bool), dots("no solution", lambda solved: not solved)]
    return Plot("Boresights on the sky", "right ascension, °", "declination, °", series)


def _reasons(runs: Sequence[FrameRun]) -> Section:
    """Count the reasons of frames without a solution. Numbers in a reason are replaced by a placeholder, so reasons
    that differ only in their numbers are counted together."""
    counts: dict[str, int] = {}
    for run in runs:
        if not run.solved:
            reason = " ".join("…" if any(c.isdigit() for c in word) else word for word in run.reason.split())
            counts[reason] = counts.get(reason, 0) + 1
    rows = [[str(n), reason or "no reason stored"] for reason, n in sorted(counts.items(), key=lambda item: -item[1])]
    table = Table("Numbers in the reasons are replaced by …", ["Frames", "Reason"], rows)
    return Section("Why frames were not solved", tables=[table] if rows else [])


def _matrix(run: FrameRun) -> NDArray[np.float64]:
    return matrix_from_quaternion(np.array(run.quaternion, float))


def _ra_dec_deg(run: FrameRun) -> tuple[float, float]:
    ra, dec, _roll = ra_dec_roll_rad(_matrix(run))
    return float(np.degrees(ra)), float(np.degrees(dec))


def _arcsec(value_rad: float | None) -> float | None:
    return None if value_rad is None else value_rad / ARCSEC_RAD
