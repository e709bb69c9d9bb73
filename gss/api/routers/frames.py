"""Frames: list, pixels, import, chains and exports."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from fastapi import Form, Query, Request, Response, UploadFile

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, AuditNote, ContactId, CurrentUser, QueryTime, RowId, User, need
from gss.api.files.cached import revalidated
from gss.api.guard.bodies import MAX_BODY_BYTES
from gss.api.schemas.base import MAX_ID
from gss.api.schemas.frames import (
    DifferenceOut,
    DownloadIn,
    FrameDetailOut,
    FramePage,
    HistogramOut,
    PinIn,
    PixelsOut,
    SolutionDetailOut,
    SolveIn,
)
from gss.api.schemas.replays import FrameReplayOut
from gss.api.schemas.transfers import FrameUploadIn, TransferOut
from gss.domain.errors import BadInput
from gss.operations.frames import pictures
from gss.operations.frames.fits_export import fits_file as fits_bytes
from gss.operations.frames.frames import Pixels
from gss.operations.frames.observer import epoch_of_frame, observer_of_frame
from gss.operations.frames.solve import SolveRequest
from gss.store.models import Frame

router = api_router("frames", "/frames")


@router.get("")
def list_frames(
    app: App,
    limit: Annotated[int, Query(ge=1, le=500)] = 50,
    offset: Annotated[int, Query(ge=0, le=10_000_000)] = 0,
    source: Literal["", "device", "import"] = "",
    outcome: Literal["", "solved", "none", "unsolved", "correct", "imprecise", "wrong"] = "",
    mode: str = "",
    contact: ContactId = None,
    start: QueryTime | None = None,
    end: QueryTime | None = None,
    least_stars: Annotated[int | None, Query(ge=0, le=10_000)] = None,
    most_stars: Annotated[int | None, Query(ge=0, le=10_000)] = None,
) -> FramePage:
    """Frames with an exposure time in ``start`` ≤ time < ``end``, newest first. ``outcome`` and star counts refer to
    the operational ground result."""
    filters = {"source": source, "outcome": outcome, "mode": mode, "contact_id": contact, "start": start, "end": end}
    total, rows = app.frames.frames.page(limit, offset, **filters, least_stars=least_stars, most_stars=most_stars)
    return FramePage(
        total=total, modes=app.frames.frames.modes(), frames=[present.frames.frame(frame, best) for frame, best in rows]
    )


@router.get("/differences")
def attitude_differences(app: App, limit: Annotated[int, Query(ge=1, le=500)] = 60) -> list[DifferenceOut]:
    """On-board minus ground attitude of the latest sensor frames that have both, oldest first."""
    return [present.frames.difference(*row) for row in reversed(app.frames.frames.attitude_pairs(limit))]


@router.get("/latest")
def latest_frame(app: App) -> FrameDetailOut:
    """Frame that was received most recently."""
    return present.frames.frame_detail(app.frames.frames.detail(app.frames.frames.latest_id()))


@router.post("/import", status_code=201, dependencies=[need("frames.import")])
def import_frame(app: App, user: User, file: UploadFile, profile: Annotated[str, Form()] = "") -> FrameDetailOut:
    """Import a FITS, PNG, TIFF or JPEG file. Without a camera profile it is solved blind."""
    data = file.file.read(MAX_BODY_BYTES + 1)
    frame = app.frames.frames.add_from_file(data, file.filename or "unnamed", profile or None, user=user)
    return present.frames.frame_detail(app.frames.frames.detail(frame.id))


@router.post("/download", status_code=201, dependencies=[need("frames.transfer")])
def download_frame(app: App, user: User, body: DownloadIn) -> TransferOut:
    """Download a frame or its thumbnail from a slot of the device."""
    app.commanding.commands.require_user(user)
    return present.records.transfer(
        app.transfers.transfers.download(body.kind, body.slot, f"{body.kind} of slot {body.slot}")
    )


@router.get("/{frame_id}")
def read_frame(app: App, frame_id: RowId) -> FrameDetailOut:
    """Frame with all its solutions."""
    return present.frames.frame_detail(app.frames.frames.detail(frame_id))


@router.get("/{frame_id}/image.png", response_class=Response)
def picture(
    app: App,
    request: Request,
    frame_id: RowId,
    low: float | None = None,
    high: float | None = None,
    stretch: Literal["asinh", "linear"] = "asinh",
    invert: bool = False,
) -> Response:
    """8-bit picture in full resolution."""
    frame = app.frames.frames.get(frame_id)
    return revalidated(
        request, frame.sha256, lambda: _picture(app.frames.frames.pixels(frame), frame, low, high, stretch, invert)
    )


def _picture(
    pixels: Pixels, frame: Frame, low: float | None, high: float | None, stretch: str, invert: bool
) -> Response:
    auto = pictures.auto_stretch(pixels, pictures.full_scale_dn(frame))
    display_range = pictures.DisplayRange(
        auto.low if low is None else low, auto.high if high is None else high, stretch == "asinh"
    )
    if not (
        math.isfinite(display_range.low)
        and math.isfinite(display_range.high)
        and display_range.low < display_range.high
    ):
        raise BadInput(
            "invalid brightness range", expected="low below high", got=f"{display_range.low:g} … {display_range.high:g}"
        )
    return Response(pictures.png(pictures.apply(pixels, display_range, invert=invert)), media_type="image/png")


@router.get("/{frame_id}/thumbnail.png", response_class=Response)
def thumbnail(app: App, request: Request, frame_id: RowId) -> Response:
    """Thumbnail that keeps stars visible."""
    frame = app.frames.frames.get(frame_id)

    def image() -> Response:
        small = pictures.thumbnail(app.frames.frames.pixels(frame), pictures.full_scale_dn(frame))
        return Response(small, media_type="image/png")

    return revalidated(request, frame.sha256, image)


@router.get("/{frame_id}/raw", response_class=Response)
def raw(app: App, request: Request, frame_id: RowId) -> Response:
    """Pixels as stored: little-endian, row by row. The header X-Dtype contains the data type, and X-Sha256 the hash of the
    pixels."""
    frame = app.frames.frames.get(frame_id)
    headers = {
        "X-Columns": str(frame.columns),
        "X-Rows": str(frame.rows),
        "X-Bits": str(frame.bits),
        "X-Dtype": frame.dtype,
        "X-Sha256": frame.sha256,
    }
    return revalidated(
        request,
        frame.sha256,
        lambda: Response(
            app.frames.frames.pixels(frame).tobytes(), media_type="application/octet-stream", headers=headers
        ),
    )


@router.get("/{frame_id}/pixels")
def pixel_values(
    app: App,
    frame_id: RowId,
    col: Annotated[int, Query(ge=-MAX_ID, le=MAX_ID)],
    row: Annotated[int, Query(ge=-MAX_ID, le=MAX_ID)],
    columns: Annotated[int, Query(ge=1, le=64)] = 15,
    rows: Annotated[int, Query(ge=1, le=64)] = 9,
) -> PixelsOut:
    """Rectangle of raw values; null outside the frame."""
    frame = app.frames.frames.get(frame_id)
    pixels = app.frames.frames.pixels(frame)
    values = [[_value(pixels, frame, r, c) for c in range(col, col + columns)] for r in range(row, row + rows)]
    return PixelsOut(col=col, row=row, columns=columns, rows=rows, values=values)


def _value(pixels: pictures.Pixels, frame: Frame, row: int, col: int) -> float | None:
    inside = 0 <= row < frame.rows and 0 <= col < frame.columns
    return float(np.asarray(pixels)[row, col]) if inside else None


@router.get("/{frame_id}/histogram")
def histogram(app: App, frame_id: RowId) -> HistogramOut:
    """Histogram of pixel values, and a stretch that shows stars."""
    frame = app.frames.frames.get(frame_id)
    pixels = app.frames.frames.pixels(frame)
    edges, counts = pictures.histogram(pixels)
    auto = pictures.auto_stretch(pixels, pictures.full_scale_dn(frame))
    return HistogramOut(edges=edges, counts=counts, low=auto.low, high=auto.high)


@router.get("/{frame_id}/file.fits", response_class=Response, dependencies=[EXPORT])
def fits_file(app: App, frame_id: RowId) -> Response:
    """Frame as FITS, with the WCS of the operational ground solution."""
    detail = app.frames.frames.detail(frame_id)
    data = fits_bytes(app.frames.frames.picture(detail.frame), detail.frame, detail.ground)
    headers = {"Content-Disposition": f"attachment; filename=frame-{frame_id}.fits"}
    return Response(data, media_type="application/fits", headers=headers)


@router.get("/{frame_id}/recording.rrd", response_class=Response, dependencies=[EXPORT])
def rerun_recording(app: App, frame_id: RowId) -> Response:
    """The frame as a Rerun recording."""
    data = app.recordings.stored.write(app.recordings.scopes.of_frames([frame_id]))
    headers = {"Content-Disposition": f"attachment; filename=frame-{frame_id}.rrd"}
    return Response(data, media_type="application/x-rerun", headers=headers)


@router.get("/{frame_id}/replay")
def replay_frame(app: App, frame_id: RowId) -> FrameReplayOut:
    """Run the sensor's own chain on the ground, with the sensor's frame, bank and parameters, and compare the
    results."""
    return present.frames.frame_replay(frame_id, app.frames.replay.again(frame_id))


@router.post("/{frame_id}/upload", status_code=201, dependencies=[need("frames.transfer")])
def upload_frame(app: App, frame_id: RowId, body: FrameUploadIn, caller: CurrentUser) -> TransferOut:
    """Send a stored frame to the sensor's image memory. With ``solve`` the frame is also solved on board, which needs
    the permission for attitude commands."""
    if body.solve:
        caller.require("command.attitude")
    app.commanding.authority.check(caller.name)
    return present.records.transfer(app.intake.images.upload(frame_id, body.slot, solve=body.solve))


@router.post("/{frame_id}/solve", status_code=201, dependencies=[need("frames.solve")])
def solve_frame(app: App, frame_id: RowId, body: SolveIn) -> SolutionDetailOut:
    """Run a chain and store its result beside the operational result. With ``store`` false, only return the result.

    Without ``profile``, ``fov_deg`` or ``blind``, the frame's own profile is used; if it has none, the frame is solved
    blind.
    """
    frame = app.frames.frames.get(frame_id)
    fov_rad = None if body.fov_deg is None else math.radians(body.fov_deg)
    profile_name = body.profile or (frame.profile if fov_rad is None and not body.blind else None)
    blind = body.blind or (profile_name is None and fov_rad is None)
    request = SolveRequest(
        chain=body.chain,
        profile=profile_name,
        fov_rad=fov_rad,
        blind=blind,
        epoch_jyear=epoch_of_frame(frame),
        observer=observer_of_frame(frame, body.aberration),
        exposure_s=frame.exposure_s,
        options=tuple(body.options.items()),
    )
    run = app.frames.frames.solve if body.store else app.frames.frames.preview
    return present.frames.solution_detail(run(frame_id, request))


@router.put("/{frame_id}/operational", dependencies=[need("frames.pin")])
def pin_solution(app: App, user: User, frame_id: RowId, body: PinIn, audit_note: AuditNote) -> FrameDetailOut:
    """Make a stored solution the frame's operational ground result, which pages, comparisons and exports use."""
    audit_note(f"frame {frame_id}: operational ground result is solution {body.solution_id}")
    app.frames.frames.pin(frame_id, body.solution_id, user=user)
    return present.frames.frame_detail(app.frames.frames.detail(frame_id))
