"""Convert exceptions to error responses. A response states what was expected, what was received, what to do next, and
an id that is also in the server's log."""

from __future__ import annotations

import http
import logging
import math
import uuid
from collections.abc import Sequence
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from gss.api.guard.headers import HEADERS
from gss.api.schemas.base import ProblemOut
from gss.domain.errors import (
    BadInput,
    Busy,
    Conflict,
    CorruptData,
    GssError,
    LinkDown,
    NotFound,
    NotPermitted,
    NotSignedIn,
    RateLimited,
    StoreDown,
    TooCostly,
    as_sentence,
)
from gss.operations.accounts.permissions import ROLES
from gss.operations.upkeep.status import Restarted

SEE = "see /api/openapi.json for all routes and fields"
log = logging.getLogger("gss.api")

STATUS: tuple[tuple[type[GssError], int], ...] = (
    (TooCostly, 413),  # before its base class
    (BadInput, 400),
    (NotFound, 404),
    (Restarted, 412),  # before its base class
    (Conflict, 409),
    (CorruptData, 409),
    (LinkDown, 503),
    (StoreDown, 503),
    (NotSignedIn, 401),
    (NotPermitted, 403),
    (RateLimited, 429),
    (Busy, 503),
)
PROBLEMS: dict[int | str, dict[str, Any]] = {
    code: {"description": http.HTTPStatus(code).phrase}
    for code in (400, 401, 403, 404, 409, 411, 412, 413, 422, 429, 503)
}
"""The error responses of every route. ``describe`` adds their schema, because otherwise the framework would prepare a
model of each code for each route."""


def describe(app: FastAPI) -> None:
    """Describe every error response as JSON in the OpenAPI document; the framework would describe the errors of HTML
    routes as HTML. Also add each role's permissions as ``x-roles`` for the pages."""
    schema = app.openapi

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            body = {"application/json": {"schema": {"$ref": "#/components/schemas/ProblemOut"}}}
            operations = (operation for path in schema()["paths"].values() for operation in path.values())
            for responses in (operation["responses"] for operation in operations):
                responses.update(
                    {code: {**response, "content": body} for code, response in responses.items() if int(code) >= 400}
                )
            schemas = schema()["components"]["schemas"]
            schemas["ProblemOut"] = ProblemOut.model_json_schema(mode="serialization")
            schema()["x-roles"] = {role: sorted(granted) for role, granted in ROLES.items()}
        return schema()

    app.openapi = openapi  # type: ignore[method-assign]  # FastAPI documents this assignment


def install(app: FastAPI) -> None:
    """Install the exception handlers. Every error response has a ProblemOut body."""

    @app.exception_handler(GssError)
    async def gss_error(request: Request, error: GssError) -> JSONResponse:
        status = next((code for kind, code in STATUS if isinstance(error, kind)), 500)
        audit_note = getattr(request.state, "detail", "")
        request.state.detail = f"{audit_note}: {error.message}" if audit_note else error.message  # for the audit record
        wait_s = error.retry_after_s if isinstance(error, RateLimited | Busy) else 0.0
        return problem(status, error.message, error.expected, error.got, error.hint, retry_after_s=wait_s)

    @app.exception_handler(RequestValidationError)
    async def invalid(_request: Request, error: RequestValidationError) -> JSONResponse:
        return problem(422, _sentence(error.errors()), hint=SEE)

    @app.exception_handler(HTTPException)
    async def framework(request: Request, error: HTTPException) -> JSONResponse:
        return problem(error.status_code, str(error.detail), got=f"{request.method} {request.url.path}", hint=SEE)

    @app.exception_handler(Exception)
    async def unknown(_request: Request, error: Exception) -> JSONResponse:
        return problem(500, "internal error of the server. The server's log has the details under this id", cause=error)


def problem(
    status: int,
    message: str,
    expected: str = "",
    got: str = "",
    hint: str = "",
    cause: Exception | None = None,
    retry_after_s: float = 0.0,
) -> JSONResponse:
    """Return the error response and write it to the log. The message and the hint are formatted as sentences."""
    texts = {"message": as_sentence(message), "expected": expected, "got": got, "hint": as_sentence(hint)}
    body = ProblemOut(id=uuid.uuid4().hex[:8], **{name: _printable(text) for name, text in texts.items()})
    log.log(logging.ERROR if status >= 500 else logging.INFO, "%s %s %s", body.id, status, message, exc_info=cause)
    later = {"Retry-After": str(math.ceil(retry_after_s))} if retry_after_s else {}
    return JSONResponse(body.model_dump(), status, headers=HEADERS | later)


def _printable(text: str) -> str:
    """Replace lone surrogates from the input, which UTF-8 cannot encode."""
    return text.encode("utf-8", "replace").decode()


def _sentence(errors: Sequence[Any]) -> str:
    problems = [f"{'.'.join(str(part) for part in e['loc'][1:]) or e['loc'][0]}: {e['msg']}" for e in errors[:3]]
    return "the request is not valid: " + "; ".join(problems)
