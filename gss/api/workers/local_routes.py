"""Routes that an API worker handles locally. All other routes are forwarded to the link process.

A route can be listed here if its response depends only on the database, the blobs and the request. State held by
services (the line, banks and tables on board, alarms, running transfers and jobs, the active camera) is valid in the
link process only.
"""

from __future__ import annotations

from starlette.routing import compile_path

LOCAL: dict[str, tuple[str, ...]] = {
    "GET": (
        "/api/openapi.json",
        "/api/stream",
        "/api/frames",
        "/api/frames/latest",
        "/api/frames/differences",
        "/api/frames/{frame_id}",
        "/api/frames/{frame_id}/image.png",
        "/api/frames/{frame_id}/thumbnail.png",
        "/api/frames/{frame_id}/raw",
        "/api/frames/{frame_id}/pixels",
        "/api/frames/{frame_id}/histogram",
        "/api/frames/{frame_id}/file.fits",
        "/api/solutions/{solution_id}",
        "/api/telemetry/history",
        "/api/telemetry/packets",
        "/api/telemetry/export",
        "/api/telemetry/cycles",
        "/api/events",
        "/api/commands.csv",
        "/api/commands.json",
        "/api/commands/facets",
        "/api/catalogues/diff",
        "/api/catalogues/sources",
        "/api/catalogues/{catalogue_id}/report.html",
        "/api/catalogues/{catalogue_id}/export",
        "/api/catalogues/{catalogue_id}/image.bin",
        "/api/catalogues/{catalogue_id}/manifest.json",
        "/api/calibrations/diff",
        "/api/calibrations/{calibration_id}/export",
        "/api/analyses",
        "/api/analyses/{analysis_id}",
        "/api/analyses/{analysis_id}/export",
        "/api/campaigns/experiments",
        "/api/campaigns/chains",
        "/api/campaigns/solutions",
        "/api/contacts",
        "/api/contacts/{contact_id}/record",
        "/api/contacts/{contact_id}/captures/{file}",
        "/api/design/cameras",
        "/api/profiles",
        "/api/rerun/re_viewer.js",
        "/api/rerun/re_viewer_bg.wasm",
        "/api/stars",
        "/api/tables/defaults",
        "/api/tables/{table_id}/file.bin",
    ),
    "POST": ("/api/design",),
}
FORWARDED = ("/api/", "/metrics")
"""Path prefixes of requests that can be forwarded. Other paths are page files, which every worker has."""


_PATTERNS = {method: [compile_path(path)[0] for path in paths] for method, paths in LOCAL.items()}


def is_local(method: str, path: str) -> bool:
    """True if a worker handles this request locally."""
    if not path.startswith(FORWARDED):
        return True
    return any(pattern.match(path) for pattern in _PATTERNS.get(method, ()))
