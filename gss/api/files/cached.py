"""Responses that a browser can cache but must revalidate before each use, and downloads of files that still grow."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path

from fastapi import Request, Response
from fastapi.responses import StreamingResponse

BLOCK_BYTES = 1 << 18


def revalidated(request: Request, content_hash: str, build: Callable[[], Response]) -> Response:
    """Return 304 if the browser has this content, else the response that ``build`` returns, with its ETag.

    The ETag is computed from the URL and ``content_hash``. Therefore the browser does not show outdated content after a
    restore has replaced the content of an id. The browser must revalidate, so it shows nothing after the user has
    signed out.
    """
    tag = hashlib.sha256(f"{request.url.path}?{request.url.query} {content_hash}".encode()).hexdigest()[:32]
    headers = {"ETag": f'"{tag}"', "Cache-Control": "private, no-cache"}
    if f'"{tag}"' in request.headers.get("if-none-match", ""):
        return Response(status_code=304, headers=headers)
    response = build()
    response.headers.update(headers)
    return response


def file_download(path: Path) -> StreamingResponse:
    """Return a file download with the current length of the file, even if the file still grows."""
    size = path.stat().st_size

    def blocks() -> Iterator[bytes]:
        remaining = size
        with path.open("rb") as file:
            while remaining and (data := file.read(min(BLOCK_BYTES, remaining))):
                remaining -= len(data)
                yield data

    headers = {"Content-Length": str(size), "Content-Disposition": f'attachment; filename="{path.name}"'}
    return StreamingResponse(blocks(), media_type="application/octet-stream", headers=headers)
