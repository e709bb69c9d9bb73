"""Statistics and design: what a camera would see and how accurate its attitude would be."""

from __future__ import annotations

from typing import Annotated, Literal, cast

from fastapi import Query, Response

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, User, need
from gss.api.schemas.design import DesignCameraOut, DesignCamerasOut
from gss.api.schemas.jobs import JobOut
from gss.catalogue_tools.design.camera import DesignCamera
from gss.operations.catalogues.design import DesignQuestion
from gss.operations.catalogues.design_record import camera_of, field_limits, row_of
from gss.operations.catalogues.design_values import DesignValues
from gss.operations.requests import request_from_text
from gss.operations.studies.analyse import AnalysisResult
from gss.operations.studies.analyses import EXPORTS
from gss.operations.studies.design_performance import sheet_file, sheet_of_design
from gss.operations.studies.sheet_record import SheetValues
from gss.wiring.services import Services

router = api_router("design", "/design")


@router.get("/cameras")
def list_cameras(app: App) -> DesignCamerasOut:
    """Documented cameras to start from."""
    cameras = [
        DesignCameraOut(
            name=p.name,
            title=p.title,
            values={k: v for k, v in camera_of(DesignCamera.from_profile(p)).items() if isinstance(v, int | float)},
            sources=p.sources,
        )
        for p in app.base.instruments.cameras().values()
    ]
    rows = [row_of(r) for r in app.catalogues.design.document_rows()]
    return DesignCamerasOut(unit=app.instruments.unit.name, cameras=cameras, rows=rows, limits=field_limits())


@router.post("", dependencies=[need("view", changes=False)])
def quick_look(app: App, body: DesignQuestion) -> DesignValues:
    """Preview with about two thousand pointings while values change."""
    return app.catalogues.design.quick(body)


@router.post("/sheet", dependencies=[need("view", changes=False)])
def performance_sheet(app: App, body: DesignQuestion) -> SheetValues:
    """Performance sheet of a design: the rows that follow from it. The other rows state what they need."""
    return cast(SheetValues, _sheet(app, body).figures)


@router.get("/sheet/export", response_class=Response, dependencies=[EXPORT])
def export_sheet(
    app: App, question: Annotated[str, Query(max_length=4000)], kind: Literal["json", "html", "pdf"] = "pdf"
) -> Response:
    """Performance sheet of a design as a file. ``question``: JSON of the request of the preview."""
    request = request_from_text(DesignQuestion, question)
    headers = {"Content-Disposition": f"attachment; filename=design-sheet.{kind}"}
    content = sheet_file(_sheet(app, request), kind, app.base.clock.now())
    return Response(content, media_type=EXPORTS[kind], headers=headers)


def _sheet(app: Services, question: DesignQuestion) -> AnalysisResult:
    design = app.catalogues.design
    return sheet_of_design(question, design.base(question), design.stars)


@router.post("/run", status_code=202, dependencies=[need("analyse")])
def full_count(app: App, user: User, body: DesignQuestion) -> JobOut:
    """Full count with the lens trade, as a job. ``design`` in the job's result has the form of the preview's
    response."""
    return present.records.job(app.catalogues.design.start(body, user=user))
