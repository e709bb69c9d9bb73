"""Rerun recordings of stored and live data, and the viewer's files, served by this server to signed-in users."""

from __future__ import annotations

import asyncio
import contextlib
import struct
from collections.abc import AsyncIterator, Callable
from typing import Annotated

from fastapi import Query, Request, Response
from fastapi.responses import StreamingResponse
from starlette import types as asgi

from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, CurrentUser, identity_still_valid
from gss.api.schemas.base import MAX_ID
from gss.domain.errors import BadInput
from gss.operations.recordings.ranges import ids_of
from gss.operations.recordings.scope import Scope
from gss.wiring.services import Services

router = api_router("rerun", "/rerun")
TYPES = {"re_viewer.js": "text/javascript", "re_viewer_bg.wasm": "application/wasm"}
RRD = "application/x-rerun"
PIECES = "application/x-gss-rrd-pieces"
NEIGHBOURS = 12
"""Number of frames before and after the displayed frame."""
GATHER_S = 0.25
PING_S = 5.0
Id = Annotated[int | None, Query(ge=1, le=MAX_ID)]


@router.get("/recording.rrd", response_class=Response, dependencies=[EXPORT])
def stored_recording(
    app: App,
    frames: Annotated[str, Query(max_length=4000)] = "",
    around: Id = None,
    contact: Id = None,
    calibration: Id = None,
    analysis: Id = None,
    campaign: Id = None,
) -> Response:
    """Recording of frames (``3,5-9``), of a frame with its neighbours (``around``), or of a contact, calibration,
    analysis or campaign. A recording of a contact with more than 2000 frames contains every n-th frame; the header
    ``X-GSS-Every`` is n."""
    scope = _scope(app, frames, around, contact, calibration, analysis, campaign)
    headers = {"Content-Disposition": f"attachment; filename={scope.name}.rrd", "X-GSS-Every": str(scope.every)}
    return Response(app.recordings.stored.write(scope), media_type=RRD, headers=headers)


def _scope(
    app: Services,
    frames: str,
    around: int | None,
    contact: int | None,
    calibration: int | None,
    analysis: int | None,
    campaign: int | None,
) -> Scope:
    selectors = [bool(frames), *(v is not None for v in (around, contact, calibration, analysis, campaign))]
    if sum(selectors) != 1:
        expected = "one of frames, around, contact, calibration, analysis, campaign"
        raise BadInput("no data selected for the recording", expected=expected, got=f"{sum(selectors)} of them")
    if around is not None:
        return app.recordings.scopes.around(around, NEIGHBOURS)
    if contact is not None:
        return app.recordings.scopes.of_contact(contact)
    if calibration is not None:
        return app.recordings.scopes.of_calibration(calibration)
    if analysis is not None:
        return app.recordings.scopes.of_analysis(analysis)
    if campaign is not None:
        return app.recordings.scopes.of_campaign(campaign)
    return app.recordings.scopes.of_frames(ids_of(frames))


@router.get("/live", response_class=StreamingResponse)
async def live_recording(request: Request, app: App, caller: CurrentUser) -> StreamingResponse:
    """Live recording until the connection or the session ends. Sent in parts: the length in four bytes, little-endian,
    then a complete .rrd file. A length of zero is a keep-alive."""
    loop, updated = asyncio.get_running_loop(), asyncio.Event()

    def wake() -> None:
        if not loop.is_closed():
            loop.call_soon_threadsafe(updated.set)

    first, live = await asyncio.to_thread(app.recordings.live.open, wake, caller.name)

    async def pieces() -> AsyncIterator[bytes]:
        yield _framed(first)
        while not app.stopping.is_set() and not await request.is_disconnected():
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(updated.wait(), PING_S)
            if await asyncio.to_thread(identity_still_valid, app, caller):
                return
            await asyncio.sleep(GATHER_S)  # a frame and its solution arrive as several messages
            updated.clear()
            yield _framed(await asyncio.to_thread(live.piece))

    return Pieces(pieces(), lambda: app.recordings.live.close(live))


class Pieces(StreamingResponse):
    """Response that closes its live recording at the end, even if the client disconnects before the first piece."""

    def __init__(self, pieces: AsyncIterator[bytes], close: Callable[[], None]) -> None:
        super().__init__(pieces, media_type=PIECES, headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"})
        self._close = close

    async def __call__(self, scope: asgi.Scope, receive: asgi.Receive, send: asgi.Send) -> None:
        """Send until the pieces end or the client disconnects."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._close()


def _framed(piece: bytes) -> bytes:
    return struct.pack("<I", len(piece)) + piece


@router.get("/{name}", response_class=Response)
def viewer_file(app: App, name: str) -> Response:
    """File of the viewer in the installed SDK."""
    data = app.recordings.viewer.file(name)
    headers = {"Content-Encoding": "gzip", "Cache-Control": "private, max-age=86400"}
    return Response(data, media_type=TYPES[name], headers=headers)
