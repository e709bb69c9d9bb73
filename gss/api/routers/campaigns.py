"""Campaigns: experiments, reprocessing and comparison of chains."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query, Response

from gss.api import present
from gss.api.deps import EXPORT, App, User, need
from gss.api.schemas.campaigns import ChainRecordOut, ExperimentOut
from gss.api.schemas.jobs import JobOut
from gss.domain.angles import ARCSEC_RAD
from gss.domain.experiment import share_interval
from gss.operations.frames.solution_export import FORMATS, export_solutions
from gss.operations.studies import experiments
from gss.operations.studies.campaigns import ChainRecord, ExperimentsRequest
from gss.operations.studies.reprocess import ReprocessRequest

router = APIRouter(prefix="/campaigns", tags=["campaigns"])


@router.get("/experiments")
def list_experiments(_: App) -> list[ExperimentOut]:
    """Experiments from the documents that can be rerun. 409 if the package that contains them is not installed."""
    return [ExperimentOut(name=e.name, title=e.title, trials=e.trials) for e in experiments.entries()]


@router.post("/experiments", status_code=201, dependencies=[need("campaigns")])
def run_experiments(app: App, user: User, body: ExperimentsRequest) -> JobOut:
    """Run experiments as a job."""
    return present.records.job(app.campaigns.run_experiments(body, user=user))


@router.post("/reprocess", status_code=201, dependencies=[need("campaigns")])
def reprocess(app: App, user: User, body: ReprocessRequest) -> JobOut:
    """Run a chain over many stored frames as a job. Starting it again processes only the remaining frames."""
    return present.records.job(app.reprocessing.start(body, user=user))


@router.get("/chains")
def compare_chains(app: App) -> list[ChainRecordOut]:
    """Results of each chain and version over the stored frames."""
    return [_chain(record) for record in app.campaigns.compare()]


def _chain(r: ChainRecord) -> ChainRecordOut:
    judged = sum(count for verdict, count in r.verdicts.items() if verdict != "none")
    return ChainRecordOut(
        chain=r.chain,
        version=r.version,
        options=r.options,
        frames=r.frames,
        solved=r.solved,
        solved_interval=share_interval(r.solved, r.frames),
        verdicts=r.verdicts,
        judged=judged,
        wrong_most=share_interval(r.verdicts.get("wrong", 0), judged)[1],
        median_error_axis_arcsec=None if r.median_error_axis_rad is None else r.median_error_axis_rad / ARCSEC_RAD,
        median_rms_px=r.median_rms_px,
        median_time_ms=None if r.median_time_s is None else 1e3 * r.median_time_s,
    )


@router.get("/solutions", response_class=Response, dependencies=[EXPORT])
def solutions_table(
    app: App, format: Literal["csv", "parquet"] = "csv", chain: Annotated[str, Query(max_length=30)] = ""
) -> Response:
    """Export all stored solutions as a table. ``chain``: only this chain."""
    headers = {"Content-Disposition": f"attachment; filename=solutions.{format}"}
    return Response(export_solutions(app.database, format, chain), media_type=FORMATS[format], headers=headers)
