"""Statistics and design: what a camera would see and how accurate its attitude would be."""

from __future__ import annotations

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import App, User, need
from gss.api.schemas.design import DesignCameraOut, DesignCamerasOut
from gss.api.schemas.jobs import JobOut
from gss.catalogue_tools.design.camera import DesignCamera
from gss.operations.catalogues.design import DesignQuestion
from gss.operations.catalogues.design_record import camera_of, field_limits, row_of
from gss.operations.catalogues.design_values import DesignValues

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


@router.post("/run", status_code=202, dependencies=[need("analyse")])
def full_count(app: App, user: User, body: DesignQuestion) -> JobOut:
    """Full count with the lens trade, as a job. ``design`` in the job's result has the form of the preview's
    response."""
    return present.records.job(app.catalogues.design.start(body, user=user))
