"""Sub-catalogues: preview, build, keep, upload."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Query, Response

from gss.api import present
from gss.api.deps import App, RowId, User
from gss.api.schemas.catalogues import CatalogueDetailOut, CatalogueIn, CatalogueOut, PreviewOut, UploadIn
from gss.api.schemas.jobs import JobOut
from gss.api.schemas.transfers import TransferOut
from gss.catalogue_tools.attitude import AttitudeLimits
from gss.catalogue_tools.request import BuildRequest, ElementsOrbit, TleOrbit
from gss.catalogue_tools.selection import Rules
from gss.domain.errors import BadInput
from gss.operations.clock import utc_now

router = APIRouter(prefix="/catalogues", tags=["catalogues"])
FIRST_YEAR, LAST_YEAR = 1950, 2150


@router.get("")
def list_catalogues(app: App, limit: Annotated[int, Query(ge=1, le=500)] = 50) -> list[CatalogueOut]:
    """Newest first."""
    banks = app.banks.views()
    return [present.catalogues.catalogue(row, banks) for row in app.catalogues.newest(limit)]


@router.post("/preview")
def preview(app: App, user: User, body: CatalogueIn) -> PreviewOut:
    """The quick look while parameters change."""
    quick = app.catalogues.preview(request_of(body, user))
    return PreviewOut(
        stars=quick.stars,
        pairs_estimate=quick.pairs,
        bytes_estimate=quick.size,
        elapsed_ms=1000 * quick.elapsed_s,
        **quick.report,
    )


@router.post("", status_code=202)
def build_catalogue(app: App, user: User, body: CatalogueIn) -> JobOut:
    """Build as a job; its result names the catalogue."""
    request = request_of(body, user)
    return present.records.job(app.catalogues.build(request, body.model_dump(mode="json"), user=user))


@router.get("/{catalogue_id}")
def read_catalogue(app: App, catalogue_id: RowId) -> CatalogueDetailOut:
    """A catalogue with its map and quality."""
    return present.catalogues.catalogue_detail(app.catalogues.get(catalogue_id), app.banks.views())


@router.get("/{catalogue_id}/image.bin", response_class=Response)
def image(app: App, catalogue_id: RowId) -> Response:
    """The bytes for the bank."""
    headers = {"Content-Disposition": f"attachment; filename=catalogue-{catalogue_id}.bin"}
    return Response(app.catalogues.image(catalogue_id), media_type="application/octet-stream", headers=headers)


@router.get("/{catalogue_id}/manifest.json", response_class=Response)
def manifest(app: App, catalogue_id: RowId) -> Response:
    """What the image holds and where it comes from."""
    text = json.dumps(app.catalogues.get(catalogue_id).manifest, indent=1)
    headers = {"Content-Disposition": f"attachment; filename=catalogue-{catalogue_id}.json"}
    return Response(text, media_type="application/json", headers=headers)


@router.post("/{catalogue_id}/upload", status_code=201)
def upload(app: App, catalogue_id: RowId, body: UploadIn, user: User) -> TransferOut:
    """Send it to an inactive bank."""
    app.authority.check(user)
    return present.records.transfer(app.catalogues.upload(catalogue_id, body.bank))


def request_of(body: CatalogueIn, user: str) -> BuildRequest:
    """Degrees to radians, words to records."""
    orbit: ElementsOrbit | TleOrbit | None = None
    attitude: AttitudeLimits | None = None
    if body.orbit == "elements":
        inclination = math.radians(body.inclination_deg)
        orbit = ElementsOrbit((inclination, inclination), _radians(body.raan_deg))
    elif body.orbit == "tle":
        orbit = TleOrbit(body.tle)
    if body.orbit != "none":
        attitude = AttitudeLimits(
            body.pointing, _radians(body.roll_deg), _radians(body.pitch_deg), _radians(body.yaw_deg)
        )
    rules = Rules(
        body.faint_mag,
        body.bright_mag,
        math.radians(body.min_separation_deg),
        body.brightest_per_field,
        body.drop_variables,
    )
    return BuildRequest(
        profile_name=body.profile,
        format_name=body.format,
        rules=rules,
        name=body.name,
        author=user,
        orbit=orbit,
        attitude=attitude,
        start=_moment(body.start) or (None if body.orbit == "none" else utc_now()),
        days=body.days,
        margin_rad=math.radians(body.margin_deg),
        pair_min_rad=math.radians(body.pair_min_deg),
        pair_max_rad=None if body.pair_max_deg is None else math.radians(body.pair_max_deg),
    )


def _radians(limits: list[float]) -> tuple[float, float]:
    return math.radians(limits[0]), math.radians(limits[1])


def _moment(text: str) -> datetime | None:
    if not text:
        return None
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise BadInput("the start is not a date", expected="ISO 8601, for example 2026-12-01", got=text[:40]) from None
    if not FIRST_YEAR <= moment.year <= LAST_YEAR:
        raise BadInput(
            "the start is far from any mission", expected=f"a year from {FIRST_YEAR} to {LAST_YEAR}", got=text[:40]
        )
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)
