"""Runs the documents' experiments as jobs, and compares the results of the chains on stored frames."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass

from pydantic import Field

from gss.operations.job_rules import nested_request
from gss.operations.jobs import JobKind, JobRequest, JobResult, JobRun, JobService
from gss.operations.requests import Request
from gss.operations.studies import experiments
from gss.operations.studies.chain_report import ChainReports
from gss.operations.studies.executor import Executor, HereExecutor
from gss.store import frames as store
from gss.store.engine import Database
from gss.store.models import Job

MAX_CONCURRENT = 40


class ExperimentsRequest(Request):
    """Experiments to run. The result of the job contains a record with columns, rows, conditions, notes and series for
    each experiment."""

    names: list[str] = Field(min_length=1, max_length=MAX_CONCURRENT)
    trials: int | None = Field(default=None, ge=1, le=10_000_000)
    seed: int = Field(default=1, ge=0, le=2**31 - 1)


@dataclass(frozen=True)
class ExperimentsJob(JobRequest):
    """Job request of experiments."""

    asked: ExperimentsRequest


@dataclass(frozen=True)
class ChainRecord:
    """All ground results of one chain, version and set of changed constants (``options``). Medians are over the solved
    frames; None without data."""

    chain: str
    version: str
    options: str
    frames: int
    solved: int
    verdicts: dict[str, int]
    median_error_axis_rad: float | None
    median_rms_px: float | None
    median_time_s: float | None


class CampaignService:
    """Starts experiments and compares chains."""

    def __init__(self, database: Database, jobs: JobService, executor: Executor | None = None) -> None:
        self._database, self._jobs = database, jobs
        self._executor = executor or HereExecutor()
        self.reports = ChainReports(database)
        jobs.register(JobKind("experiments", ExperimentsJob, self._run, older=nested_request))

    def run_experiments(self, spec: ExperimentsRequest, *, user: str) -> Job:
        """Queue experiments. The result of the job contains a record of each experiment. Raises NotFound or BadInput
        before the job is queued."""
        for name in spec.names:
            experiments.check(name, spec.trials, spec.seed)
        title = spec.names[0] if len(spec.names) == 1 else f"{len(spec.names)} experiments"
        return self._jobs.begin("experiments", title, ExperimentsJob(spec, user=user))

    def _run(self, request: ExperimentsJob, run: JobRun) -> JobResult:
        return _experiments(request.asked, run, self._executor)

    def compare(self) -> list[ChainRecord]:
        """Return a record for each chain, version and set of changed constants that ran on stored frames. Only the
        latest result per frame counts."""
        with self._database.unit_of_work() as session:
            rows = store.newest_by_chain(session)
        groups: dict[tuple[str, str, str], list[store.SolutionOutcome]] = {}
        for row in rows:
            groups.setdefault((row.chain, row.version, row.options), []).append(row)
        return [_record(*key, group) for key, group in sorted(groups.items())]


def _experiments(spec: ExperimentsRequest, run: JobRun, executor: Executor) -> JobResult:
    """Run all experiments. Each completed experiment is added to the checkpoint; after a crash, only the experiments in
    progress are rerun."""
    names = spec.names
    completed_records = list((run.checkpoint or {}).get("experiments", ()))
    remaining = [(name, spec.trials, spec.seed) for name in names[len(completed_records) :]]

    def report_share(share: float) -> None:
        if len(completed_records) < len(names):
            text = f"{names[len(completed_records)]}, {100 * share:.0f} %"
            run.progress(round(100 * (len(completed_records) + share)), 100 * len(names), text)

    report_share(0.0)
    with closing(executor.in_order(experiments.run_item, remaining, report_share)) as records:
        for record in records:
            completed_records.append(record)
            run.keep({"experiments": completed_records})
            report_share(0.0)
    return {"experiments": completed_records}


def _record(chain: str, version: str, options: str, rows: Sequence[store.SolutionOutcome]) -> ChainRecord:
    verdicts: dict[str, int] = {}
    for row in rows:
        if row.verdict:
            verdicts[row.verdict] = verdicts.get(row.verdict, 0) + 1
    return ChainRecord(
        chain,
        version,
        options,
        len(rows),
        sum(row.outcome == "solved" for row in rows),
        verdicts,
        _median([row.error_axis_rad for row in rows]),
        _median([row.rms_px for row in rows]),
        _median([sum(row.timing_s.values()) if row.timing_s else None for row in rows]),
    )


def _median(values: Sequence[float | None]) -> float | None:
    numbers = sorted(v for v in values if v is not None)
    if not numbers:
        return None
    middle = len(numbers) // 2
    return numbers[middle] if len(numbers) % 2 else (numbers[middle - 1] + numbers[middle]) / 2
