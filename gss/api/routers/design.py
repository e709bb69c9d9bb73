"""Statistics and design: what a camera would see and how accurate its attitude would be."""

from __future__ import annotations

import math

from fastapi import APIRouter

from gss.api import present
from gss.api.deps import App, need
from gss.api.schemas.design import DesignCameraOut, DesignCamerasOut, DesignIn, DesignOut, FieldLimitOut, TradeRowOut
from gss.api.schemas.jobs import JobOut
from gss.catalogue_tools.design.camera import DesignCamera
from gss.domain.profiles import PROFILES
from gss.operations.catalogues.design import Along, Question, radians
from gss.operations.catalogues.design_record import camera_of, field_limits, row_of

router = APIRouter(prefix="/design", tags=["design"])
NOT_OF_THE_CAMERA = {
    "profile",
    "exclusion_deg",
    "spare_mm",
    "sky",
    "inclination_deg",
    "raan_deg",
    "pointing",
    "roll_deg",
    "pitch_deg",
    "yaw_deg",
    "seed",
    "pointings",
}


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
        for p in PROFILES.values()
    ]
    limits = {name: FieldLimitOut(**limit) for name, limit in field_limits().items()}
    rows = [TradeRowOut(**row_of(r)) for r in app.design.document_rows()]
    return DesignCamerasOut(cameras=cameras, rows=rows, limits=limits)


@router.post("", dependencies=[need("view", changes=False)])
def quick_look(app: App, body: DesignIn) -> DesignOut:
    """Preview while values change: about two thousand pointings."""
    return DesignOut(**app.design.quick(question_of(body)))


@router.post("/run", status_code=202, dependencies=[need("analyse")])
def full_count(app: App, body: DesignIn) -> JobOut:
    """Full count with the lens trade, as a job. ``design`` in its result has the form of the preview's response."""
    return present.records.job(app.design.start(question_of(body), body.model_dump(mode="json")))


def question_of(body: DesignIn) -> Question:
    """Convert the request: degrees to radians, text to records."""
    values = body.model_dump(exclude=NOT_OF_THE_CAMERA, exclude_none=True)
    along = None
    if body.sky == "orbit":
        inclination = math.radians(body.inclination_deg)
        along = Along(
            (inclination, inclination),
            radians(body.raan_deg),
            body.pointing,
            radians(body.roll_deg),
            radians(body.pitch_deg),
            radians(body.yaw_deg),
        )
    exclusion = None if body.exclusion_deg is None else math.radians(body.exclusion_deg)
    return Question(body.profile, values, exclusion, body.spare_mm, along, body.seed, body.pointings)
