"""Campaigns: experiments, reprocessing and comparison of chains."""

from __future__ import annotations

from typing import Annotated, Literal
from urllib.parse import quote

from fastapi import Query, Response

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, User, need
from gss.api.schemas.campaigns import ChainFailureOut, ChainPairIn, ChainRecordOut, ChainReportOut, ExperimentOut
from gss.api.schemas.jobs import JobOut
from gss.domain.angles import ARCSEC_RAD
from gss.domain.experiment import share_interval
from gss.operations.clock import utc_now
from gss.operations.report.pdf import as_pdf
from gss.operations.studies import experiments
from gss.operations.studies.campaigns import ChainRecord, ExperimentsRequest
from gss.operations.studies.chain_report import ChainReport
from gss.operations.studies.reprocess import ReprocessRequest
from gss.store.frames import ChainKey

router = api_router("campaigns", "/campaigns")


@router.get("/experiments")
def list_experiments(_: App) -> list[ExperimentOut]:
    """Experiments from the documents that can be rerun. The status is 409 if the package that contains the experiments
    is not installed."""
    return [ExperimentOut(name=e.name, title=e.title, trials=e.trials) for e in experiments.entries()]


@router.post("/experiments", status_code=201, dependencies=[need("campaigns")])
def run_experiments(app: App, user: User, body: ExperimentsRequest) -> JobOut:
    """Run experiments as a job."""
    return present.records.job(app.studies.campaigns.run_experiments(body, user=user))


@router.post("/reprocess", status_code=201, dependencies=[need("campaigns")])
def reprocess(app: App, user: User, body: ReprocessRequest) -> JobOut:
    """Run a chain over many stored frames as a job. Starting it again processes only the remaining frames."""
    return present.records.job(app.studies.reprocessing.start(body, user=user))


@router.get("/chains")
def compare_chains(app: App) -> list[ChainRecordOut]:
    """Results of each chain and version over the stored frames."""
    return [_chain(record) for record in app.studies.campaigns.compare()]


@router.get("/chains/report")
def chain_report(app: App, pair: Annotated[ChainPairIn, Query()]) -> ChainReportOut:
    """Report on a chain over the stored frames: rate, errors, failed frames and reasons. The chain is compared with
    another chain or, without ``against_chain``, with the operational result of each frame."""
    report = _report(app, pair)
    return ChainReportOut(
        report=report.report,
        failures=[ChainFailureOut.model_validate(f) for f in report.failures],
        failed=report.failed,
    )


@router.get("/chains/report.pdf", response_class=Response, dependencies=[EXPORT])
def chain_report_pdf(app: App, pair: Annotated[ChainPairIn, Query()]) -> Response:
    """Report on a chain as a PDF file."""
    headers = {"Content-Disposition": f"attachment; filename={quote(pair.chain)}.pdf"}
    return Response(as_pdf(_report(app, pair).report, utc_now()), media_type="application/pdf", headers=headers)


def _report(app: App, pair: ChainPairIn) -> ChainReport:
    against = ChainKey(pair.against_chain, pair.against_version, pair.against_options) if pair.against_chain else None
    return app.studies.campaigns.reports.report(ChainKey(pair.chain, pair.version, pair.options), against)


def _chain(record: ChainRecord) -> ChainRecordOut:
    judged = sum(count for verdict, count in record.verdicts.items() if verdict != "none")
    return ChainRecordOut(
        chain=record.chain,
        version=record.version,
        options=record.options,
        frames=record.frames,
        solved=record.solved,
        solved_interval=share_interval(record.solved, record.frames),
        verdicts=record.verdicts,
        judged=judged,
        wrong_most=share_interval(record.verdicts.get("wrong", 0), judged)[1],
        median_error_axis_arcsec=None
        if record.median_error_axis_rad is None
        else record.median_error_axis_rad / ARCSEC_RAD,
        median_rms_px=record.median_rms_px,
        median_time_ms=None if record.median_time_s is None else 1e3 * record.median_time_s,
    )


@router.get("/solutions", response_class=Response, dependencies=[EXPORT])
def solutions_table(
    app: App, format: Literal["csv", "parquet"] = "csv", chain: Annotated[str, Query(max_length=30)] = ""
) -> Response:
    """Export all stored solutions as a table. ``chain``: only this chain."""
    from gss.operations.frames.solution_export import FORMATS, export_solutions  # Arrow takes 30 MB of memory

    headers = {"Content-Disposition": f"attachment; filename=solutions.{format}"}
    return Response(export_solutions(app.base.database, format, chain), media_type=FORMATS[format], headers=headers)
