"""Run experiments by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.errors import BadInput, NotFound
from gss.domain.experiment import Curve, Experiment, ExperimentEntry, Progress
from validation.entries import ENTRIES

FAINTEST_MAG = 8.0
MAX_TRIALS = 10_000_000
DEFAULT_SEED = 1


def entry(name: str) -> ExperimentEntry:
    """Return the experiment with that name. Raises NotFound."""
    try:
        return ENTRIES[name]
    except KeyError:
        raise NotFound("unknown experiment", expected=" | ".join(ENTRIES), got=name) from None


def default_trials(name: str, share: float = 1.0) -> int:
    """Return a share of the default number of trials of an experiment, at least one. Raises NotFound."""
    return max(1, round(share * entry(name).trials))


def check(name: str, trials: int | None, seed: int) -> int:
    """Return the number of trials of a run. Raises NotFound or BadInput if the run is not possible."""
    count = entry(name).trials if trials is None else trials
    if not 1 <= count <= MAX_TRIALS:
        raise BadInput("number of trials is out of range", expected=f"1 – {MAX_TRIALS}", got=str(count))
    if seed < 0:
        raise BadInput("the seed is negative", expected="0 or more", got=str(seed))
    return count


def run_experiment(
    name: str, *, trials: int | None = None, seed: int = DEFAULT_SEED, progress: Progress = lambda _: None
) -> Experiment:
    """Run an experiment. ``trials`` None: its default number. The same seed and trials give the same results."""
    experiment, count = entry(name), check(name, trials, seed)
    stars = propagate(load_stars(FAINTEST_MAG), experiment.epoch_jyear)
    return experiment.rerun(stars, count, seed, progress)


def as_record(experiment: Experiment) -> dict[str, Any]:
    """Return plain values for JSON."""
    return asdict(experiment)


def from_record(record: Mapping[str, Any]) -> Experiment:
    """Restore an experiment from plain values."""
    values = dict(record)
    curves: list[dict[str, Any]] = [
        {k: tuple(v) if isinstance(v, list) else v for k, v in curve.items()} for curve in values["series"]
    ]
    series = tuple(Curve(**curve) for curve in curves)
    values |= {name: tuple(values[name]) for name in ("columns", "conditions", "notes")}
    return Experiment(**(values | {"rows": tuple(tuple(row) for row in values["rows"]), "series": series}))
