"""The documents' experiments by name: run, recorded, and formatted as text or as a page."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from gss.catalogue_tools import experiments as catalogue
from gss.catalogue_tools.selection import huffman
from gss.catalogue_tools.selection.moniteq import moniteq_screening
from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.errors import BadInput, NotFound
from gss.domain.experiment import Cell, Experiment, Progress, Series
from gss.domain.stars import StarTable
from gss.pipeline.experiments.erlank_attitude import erlank_4_4b
from gss.pipeline.experiments.erlank_centroids import erlank_4_1_6
from gss.pipeline.experiments.erlank_matching import erlank_4_4, erlank_4_5
from gss.pipeline.experiments.erlank_night import erlank_6_1
from gss.pipeline.experiments.erlank_slew import erlank_6_2
from gss.pipeline.experiments.huffman_centroids import huffman_4_2, huffman_4_4
from gss.pipeline.experiments.huffman_detection import huffman_7_2
from gss.pipeline.experiments.huffman_magnitudes import huffman_5_3
from gss.pipeline.experiments.huffman_matching import huffman_8_2
from gss.pipeline.experiments.jacobs_3_7 import jacobs_3_7
from gss.pipeline.experiments.jacobs_calibration import jacobs_6
from gss.pipeline.experiments.jacobs_tracking import jacobs_fig_2_7, jacobs_tracking
from gss.pipeline.experiments.liebe_tables import liebe_2, liebe_3, liebe_18
from gss.pipeline.experiments.moniteq_locator import moniteq_4_2, moniteq_nea, moniteq_noise
from gss.pipeline.experiments.moniteq_sky import moniteq_2_1, moniteq_links
from gss.pipeline.experiments.never_wrong import never_wrong

Rerun = Callable[[StarTable, int, int, Progress], Experiment]
FAINTEST_MAG = 8.0
MOST_TRIALS = 10_000_000
DEFAULT_SEED = 1


@dataclass(frozen=True)
class Entry:
    """One experiment. ``trials``: default number; ``epoch_jyear``: of the star positions."""

    name: str
    title: str
    rerun: Rerun
    trials: int
    epoch_jyear: float = 2000.0


ENTRIES: dict[str, Entry] = {
    e.name: e
    for e in (
        Entry("jacobs-5-1", "Stars in a Sunsat image", catalogue.jacobs_5_1, 1_000_000, 1991.25),
        Entry("jacobs-5-2", "Sizes of Sunsat's sub-catalogues", catalogue.jacobs_5_2, 1, 1991.25),
        Entry("jacobs-3-7", "Sunsat's matching: right, none, wrong", jacobs_3_7, 400, 1991.25),
        Entry("jacobs-6", "Calibration of Sunsat's camera", jacobs_6, 20, 1991.25),
        Entry("jacobs-tracking", "Tracking among false stars", jacobs_tracking, 100, 1991.25),
        Entry("jacobs-fig-2-7", "Cost of region growing against area", jacobs_fig_2_7, 20, 1991.25),
        Entry("erlank-3-6", "Sky coverage against limiting magnitude", catalogue.erlank_3_6, 20_000),
        Entry("erlank-fig-3-8", "Sky coverage by field and magnitude", catalogue.erlank_fig_3_8, 20_000),
        Entry("erlank-4-1-6", "Centroid error on artificial images", erlank_4_1_6, 300),
        Entry("erlank-4-4", "Matching against the cutoff of magnitude", erlank_4_4, 500),
        Entry("erlank-4-5", "Matching among false stars", erlank_4_5, 500),
        Entry("erlank-4-4b", "Best-case accuracy of the attitude", erlank_4_4b, 300),
        Entry("erlank-6-1", "Accuracy fixed to the Earth", erlank_6_1, 100),
        Entry("erlank-6-2", "Tracking while slewing", erlank_6_2, 4),
        Entry("huffman-4-2", "Maximum likelihood against weighted sum", huffman_4_2, 10),
        Entry("huffman-4-4", "Centroid error against PSF width and SNR", huffman_4_4, 2_000),
        Entry("huffman-5-1", "Limiting magnitude for a number of stars", huffman.huffman_5_1, 10_000),
        Entry("huffman-5-3", "Magnitudes measured from frames", huffman_5_3, 25),
        Entry("huffman-5-5", "The eight brightest of every field", huffman.huffman_5_5, 10_000),
        Entry("huffman-7-2", "Two centroiders at five thresholds", huffman_7_2, 6),
        Entry("huffman-8-2", "Matching algorithms on sequences", huffman_8_2, 20),
        Entry("liebe-2", "Correct initial estimates by kind of error", liebe_2, 500, 1994.95),
        Entry("liebe-3", "Accuracy of the predictional estimate by kind of error", liebe_3, 500, 1994.95),
        Entry("liebe-18", "Accuracy of the boresight against the number of stars", liebe_18, 10_000, 1994.95),
        Entry("moniteq-2-1", "Stars by magnitude and in a field", moniteq_2_1, 10_000),
        Entry("moniteq-4-2", "Systematic error of the mean locator", moniteq_4_2, 1),
        Entry("moniteq-noise", "Noise of the mean locator", moniteq_noise, 60_000),
        Entry("moniteq-nea", "Noise equivalent angle against orbital rate", moniteq_nea, 1),
        Entry("moniteq-links", "Walking links against searching the list", moniteq_links, 500),
        Entry("moniteq-screening", "False matches by chance, and stars to screen out", moniteq_screening, 9_000),
        Entry("never-wrong", "False attitudes under every fault", never_wrong, 30),
    )
}


def entry(name: str) -> Entry:
    """Return the experiment with that name. Raises NotFound."""
    try:
        return ENTRIES[name]
    except KeyError:
        raise NotFound("unknown experiment", expected=" | ".join(ENTRIES), got=name) from None


def check(name: str, trials: int | None, seed: int) -> int:
    """Return the number of trials that a run would take. Raises NotFound or BadInput if it cannot run."""
    count = entry(name).trials if trials is None else trials
    if not 1 <= count <= MOST_TRIALS:
        raise BadInput("number of trials is out of range", expected=f"1 – {MOST_TRIALS}", got=str(count))
    if seed < 0:
        raise BadInput("a seed is not negative", expected="0 or more", got=str(seed))
    return count


def run_experiment(
    name: str, *, trials: int | None = None, seed: int = DEFAULT_SEED, progress: Progress = lambda _: None
) -> Experiment:
    """Run an experiment. ``trials`` None: its default number. The same seed and trials give the same results."""
    found, count = entry(name), check(name, trials, seed)
    stars = propagate(load_stars(FAINTEST_MAG), found.epoch_jyear)
    return found.rerun(stars, count, seed, progress)


def run_item(asked: tuple[str, int | None, int], told: Progress) -> dict[str, Any]:
    """Run (name, trials, seed) for an executor and return the record of the run."""
    name, trials, seed = asked
    return as_record(run_experiment(name, trials=trials, seed=seed, progress=told))


def as_record(experiment: Experiment) -> dict[str, Any]:
    """Return plain values for JSON."""
    return asdict(experiment)


def from_record(record: Mapping[str, Any]) -> Experiment:
    """Restore an experiment from plain values."""
    values = dict(record)
    curves: list[dict[str, Any]] = [
        {k: tuple(v) if isinstance(v, list) else v for k, v in curve.items()} for curve in values["series"]
    ]
    series = tuple(Series(**curve) for curve in curves)
    values |= {name: tuple(values[name]) for name in ("columns", "conditions", "notes")}
    return Experiment(**(values | {"rows": tuple(tuple(row) for row in values["rows"]), "series": series}))


@dataclass(frozen=True)
class Done:
    """A stored run: ``trials`` requested, ``processor_s`` used, ``code``: fingerprint of the sources that determine the
    results."""

    experiment: Experiment
    trials: int
    processor_s: float
    code: str


class Shelf:
    """Stores runs as lines of a file, so that an interrupted page can be resumed. A line cut off by a crash is ignored."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._held: dict[tuple[str, int, int], Done] = {}
        for line in file.read_text("utf-8").splitlines() if file.is_file() else ():
            try:
                record = json.loads(line)
                done = Done(from_record(record["experiment"]), record["trials"], record["processor_s"], record["code"])
            except (ValueError, KeyError, TypeError):
                continue
            self._held[done.experiment.name, done.trials, done.experiment.seed] = done

    def get(self, name: str, trials: int, seed: int) -> Done | None:
        """Return a stored run; None if there is none."""
        return self._held.get((name, trials, seed))

    def keep(self, done: Done) -> None:
        """Store a run."""
        self._held[done.experiment.name, done.trials, done.experiment.seed] = done
        record = {"trials": done.trials, "processor_s": done.processor_s, "code": done.code}
        with self._file.open("a", encoding="utf-8") as out:
            out.write(json.dumps(record | {"experiment": as_record(done.experiment)}, ensure_ascii=False) + "\n")


def as_text(experiment: Experiment) -> str:
    """Return a text table for the terminal."""
    cells = [list(experiment.columns), *([show(c) for c in row] for row in experiment.rows)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(experiment.columns))]
    lines = [f"{experiment.title} ({experiment.source}), seed {experiment.seed}", *experiment.conditions, ""]
    lines += ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in cells]
    return "\n".join([*lines, *(f"Note: {note}" for note in experiment.notes)])


def as_page(
    experiments: Sequence[Experiment],
    version: str,
    share: float = 1.0,
    processor_s: Mapping[str, float] | None = None,
) -> str:
    """Return ``docs/experiments.md``: every table of a run, each with that ``share`` of its default number of trials.
    ``processor_s``: time used by each."""
    took = processor_s or {}
    asked = "" if share == 1.0 else f" --share {share:g}"
    parts = [
        "# The documents' tables, rerun\n",
        f"Written by `gss experiments run --all{asked} --page`, version {version}; each says "
        "how many trials it had. Intervals are 95 % (Wilson). The same seed and number "
        "of trials give the same figures. The hunt for false attitudes at length is in [never-wrong.md](never-wrong.md).\n",
    ]
    for e in experiments:
        head = "| " + " | ".join(e.columns) + " |\n|" + "---|" * len(e.columns)
        body = "\n".join("| " + " | ".join(show(c).replace("|", "\\|") for c in row) + " |" for row in e.rows)
        time = (f"{took[e.name]:.0f} s of processor time",) if e.name in took else ()
        said = "\n".join(f"- {text}" for text in (*e.conditions, f"seed {e.seed}", *time))
        notes = "".join(f"\n{note}\n" for note in e.notes)
        parts.append(f"## {e.name}: {e.title}\n\n{e.source}\n\n{said}\n\n{head}\n{body}\n{notes}")
    return "\n".join(parts).rstrip() + "\n"


def show(cell: Cell) -> str:
    """Format a cell for display."""
    if cell is None:
        return "–"
    return f"{cell:.6g}" if isinstance(cell, float) else str(cell)
