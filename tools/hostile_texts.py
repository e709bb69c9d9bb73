"""Texts with markup for every request of the API that stores or shows text, and the fields that need none.

``{frame}``, ``{alarm}``, ``{procedure}`` and ``{run}`` in a path or ``id`` in a body stand for rows that the caller creates.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any
from urllib.parse import quote

Json = Mapping[str, object]
MARK = "class=injected"
MARKUP = f'"><img src=x {MARK} onerror="window.injected=1">'
SHORT = f"<b {MARK}>"
"""Markup that is short enough for the shortest names."""
TLE = """1 25544U 98067A   26329.51782528 -.00002182  00000-0 -11606-4 0  2929
2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537"""
PROCEDURE = (
    f"# {MARKUP}\n\n{MARKUP}\n\n## first: {MARKUP}\n\n```hold\n{MARKUP}\n```\n\n"
    f"## second: {MARKUP}\n\n```hold\n{MARKUP}\n```\n\n## third: {MARKUP}\n\n```hold\n{MARKUP}\n```\n"
)
COMMAND = {"name": MARKUP, "arguments": {"mode": MARKUP}, "confirm": MARKUP}
DOTS = [[100.0, 120.0], [112.0, 120.0], [106.0, 126.0], [106.0, 114.0], [110.2, 124.2], [101.8, 115.8]]

STORED: tuple[tuple[str, str, Json], ...] = (
    ("POST", "/users", {"name": MARKUP, "role": "viewer"}),
    ("POST", "/tokens", {"name": SHORT, "role": "viewer", "days": 1}),
    ("POST", "/procedures", {"text": PROCEDURE}),
    ("PUT", "/contacts/1/note", {"note": MARKUP}),
    ("PUT", "/checklist", {"items": [MARKUP], "version": 1}),
    ("PUT", "/contacts/1/checklist", {"item": MARKUP, "done": True}),
    ("POST", "/contacts/1/handover-notes", {"text": MARKUP}),
    ("PUT", "/session/start-page", {"path": f"/frames?name={quote(MARKUP)}"}),
    ("PUT", "/telemetry/limits/set", {"name": "nominal", "note": MARKUP}),
    (
        "PUT",
        "/telemetry/limits/housekeeping.sensor_temperature_c",
        {"watch": [-90, -80], "persistence": 1, "note": MARKUP},
    ),
    (
        "POST",
        "/telemetry/derived",
        {"name": "hostile", "expression": "housekeeping.iteration", "title": MARKUP, "unit": SHORT},
    ),
    ("POST", "/views", {"name": MARKUP, "path": f"/frames?name={quote(MARKUP)}", "note": MARKUP}),
    ("POST", "/stations", {"name": SHORT, "latitude_deg": 50.0, "longitude_deg": 7.0, "note": MARKUP}),
    ("PUT", "/spacecraft", {"text": TLE, "name": MARKUP, "source": MARKUP}),
    (
        "POST",
        "/fleet/spacecraft",
        {
            "name": SHORT,
            "heads": [{"unit": SHORT, "mounting_deg": [0, 0, 0]}, {"unit": "b", "mounting_deg": [0, 90, 0]}],
        },
    ),
    ("POST", "/tables", {"kind": "parameters", "name": MARKUP, "profile": "cubestar"}),
    ("POST", "/catalogues", {"name": MARKUP, "faint_mag": 2.5}),
    (
        "POST",
        "/calibrations",
        {"kind": "bench-centre", "profile": "cubestar", "dots_px": DOTS, "name": MARKUP, "note": MARKUP},
    ),
)
"""Requests that the server must accept."""

ATTEMPTED: tuple[tuple[str, str, Json], ...] = (
    ("POST", "/session", {"name": MARKUP, "password": "wrong password"}),
    ("POST", "/link/open", {"url": MARKUP}),
    ("POST", "/commands", COMMAND),
    ("POST", "/commands", {"name": "GET_STATUS", "arguments": {MARKUP: MARKUP}}),
    (
        "POST",
        "/schedule",
        {"command": MARKUP, "arguments": {SHORT: SHORT}, "confirm": MARKUP, "at": "2030-01-01T00:00:00Z"},
    ),
    ("PUT", "/telemetry/limits/set", {"name": MARKUP, "note": ""}),
    ("POST", "/telemetry/derived", {"name": SHORT, "expression": MARKUP, "title": "", "unit": ""}),
    ("POST", "/stations", {"name": "b", "latitude_deg": 50.0, "longitude_deg": 7.0, "line_url": MARKUP}),
    ("PUT", "/spacecraft", {"text": MARKUP, "name": "", "source": ""}),
    ("POST", "/fleet/spacecraft/1/correct", {"unit": SHORT}),
    ("POST", "/tables", {"kind": "parameters", "name": "", "profile": SHORT, "content": {MARKUP: MARKUP}}),
    ("POST", "/tables/1/upload", {"bank": SHORT}),
    ("POST", "/transfers/download", {"kind": "catalogue", "bank": SHORT}),
    ("POST", "/notifications/test", {"target": SHORT}),
    ("POST", "/frames/{frame}/solve", {"chain": SHORT, "profile": SHORT, "options": {SHORT: SHORT}}),
    ("POST", "/catalogues/preview", {"name": MARKUP, "profile": SHORT, "format": SHORT, "start": SHORT, "tle": MARKUP}),
    ("POST", "/design", {"profile": SHORT, "pointing": SHORT}),
    ("POST", "/analyses", {"kind": "telemetry", "contact": 1, "title": MARKUP}),
    ("POST", "/analyses", {"kind": "sheet", "profile": "cubestar", "frame_ids": [1], "title": MARKUP, "chain": SHORT}),
    (
        "POST",
        "/campaigns/reprocess",
        {"chain": SHORT, "profile": SHORT, "source": SHORT[:10], "options": {SHORT: SHORT}},
    ),
    ("POST", "/campaigns/experiments", {"names": [SHORT]}),
    (
        "POST",
        "/instruments/photographs",
        {"name": "own", "title": MARKUP, "model": SHORT, "frame_ids": [1, 2, 3], "date": "2026-11-26"},
    ),
    ("POST", "/pass-plans/1/arm", {"confirm": [MARKUP]}),
    ("POST", "/pass-plans/1/rehearsals", {"answers": {MARKUP: MARKUP}}),
    ("POST", "/commands/1/resolve", {"result": "completed", "note": MARKUP}),
)
"""Requests that the server may reject. Error messages, the audit log and events then contain the text."""

LATER: tuple[tuple[str, str, Json], ...] = (
    ("POST", "/procedure-runs/{run}/step", {"step": "first", "note": MARKUP, "answer": MARKUP, "confirm": MARKUP[:60]}),
    ("POST", "/procedure-runs/{run}/skip", {"step": "first", "reason": MARKUP}),
    ("POST", "/procedure-runs/{run}/stop", {"reason": MARKUP}),
    ("POST", "/alarms/{alarm}/acknowledge", {"note": MARKUP}),
    ("POST", "/alarms/{alarm}/shelve", {"minutes": 60, "note": MARKUP}),
    ("POST", "/authority/request", {"note": MARKUP}),
    ("POST", "/authority/offer", {"user": MARKUP, "note": MARKUP}),
    ("POST", "/authority/break", {"reason": MARKUP}),
)
"""Requests about rows that the earlier requests created."""

NOT_TRIED = {
    "SetUpBody.name": "the set-up ends with the first user; the rules for names are those of UserIn.name",
    "SetUpBody.token": "a secret, which is neither stored nor shown",
    "PasswordLinkBody.token": "a secret, which is neither stored nor shown",
    "LinkCheckBody.token": "a secret, which is neither stored nor shown",
    "TokenIn.scopes": "one of the permissions",
    "ScheduleCheckIn.command": "same check as ScheduleIn.command",
    "ScheduleCheckIn.arguments": "same check as ScheduleIn.arguments",
    "ProcedureStartIn.confirm": "compared with names of commands",
    "ExpressionIn.expression": "same parser as DerivedRequest.expression",
    "Body_solve_lists_api_lists_post.camera": "name of a camera, checked before the file is stored",
    "CatalogueHead.unit": "name of a stored head",
    "StarCalibration.models": "models of the lens",
    "MovingRequest.objects": "element sets; the names in them are cut and shown as in OrbitIn.text",
    "MovingRequest.orbit": "parsed as OrbitIn.text",
    "HealthRequest.orbit": "parsed as OrbitIn.text",
    "DocumentedIn.profile": "name of a camera",
    "PlanIn.name": "shown by the components of procedures; a plan needs a pass, which depends on the date",
    "PlanItemIn.bank": "name of a bank",
    "StepRunIn.step": "identifier of a step of the run",
    "StepSkipIn.step": "identifier of a step of the run",
}
"""Free text fields without markup in the requests above, with the reason."""
CAMERA_FIELDS = ("profile", "other_profile")
"""Names of cameras, which every request compares with the installed instruments."""


def marked_fields(body: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Yield the path of each text with markup in a body, without positions in lists."""
    if isinstance(body, dict):
        for key, value in body.items():
            yield from marked_fields(value, (*path, key))
    elif isinstance(body, list):
        for item in body:
            yield from marked_fields(item, path)
    elif isinstance(body, str) and ("<b" in body or "injected" in body):
        yield path
