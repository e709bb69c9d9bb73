"""Attitudes of stored frames as CCSDS messages, and their comparison with another system."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from fastapi import Form, UploadFile
from fastapi.responses import Response, StreamingResponse

from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, QueryTime, need
from gss.api.present.attitudes import comparison
from gss.api.schemas.attitudes import AttitudeComparisonOut
from gss.domain.errors import BadInput
from gss.operations.frames.attitude_exchange import AttitudeOrigin
from gss.orbit.write_attitude import MessageFormat

router = api_router("frames", "/attitudes")
MAX_BYTES = 20 << 20


@router.get("/message", dependencies=[EXPORT], response_class=Response)
def export_attitudes(
    app: App, start: QueryTime, end: QueryTime, format: MessageFormat = "aem", origin: AttitudeOrigin = "ground"
) -> StreamingResponse:
    """Export the attitudes of frames exposed in a span as a CCSDS AEM or ACM in KVN."""
    return message_file(app.passes.attitudes.message(format, origin, start, end), format)


def message_file(lines: Iterator[str], format: MessageFormat) -> StreamingResponse:
    """Return the response with an attitude message as a file."""
    headers = {"Content-Disposition": f"attachment; filename=attitudes.{format}"}
    return StreamingResponse((line.encode() for line in lines), media_type="text/plain; charset=utf-8", headers=headers)


@router.post("/compare", dependencies=[need("view", changes=False)])
def compare_attitudes(
    app: App, file: UploadFile, origin: Annotated[AttitudeOrigin, Form()] = "ground"
) -> AttitudeComparisonOut:
    """Compare stored frames with the attitudes of a CCSDS AEM or ACM in KVN; nothing is stored."""
    data = file.file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise BadInput("The file is too large", expected=f"at most {MAX_BYTES >> 20} MiB")
    return comparison(app.passes.attitudes.compare(data, origin))
