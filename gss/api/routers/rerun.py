"""The Rerun viewer's own files, behind our origin and our policy."""

from __future__ import annotations

from fastapi import APIRouter, Response

from gss.api.deps import App

router = APIRouter(prefix="/rerun", tags=["rerun"])
TYPES = {"re_viewer.js": "text/javascript", "re_viewer_bg.wasm": "application/wasm", "favicon.ico": "image/x-icon"}


@router.get("/{name}", response_class=Response)
def viewer_file(app: App, name: str) -> Response:
    """One file of the viewer of the installed SDK."""
    data = app.viewer.file(name)
    headers = {"Content-Encoding": "gzip", "Cache-Control": "private, max-age=86400"}
    return Response(data, media_type=TYPES[name], headers=headers)
