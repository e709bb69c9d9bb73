"""Every route of the API receives requests generated from its own description: no server error, no hang, and responses
as described. The description is the application's OpenAPI schema. schemathesis generates requests that follow it and
requests that violate it. The number of requests is limited and the inputs are the same in every run;
``GSS_FUZZ_EXAMPLES=500 GSS_FUZZ_SEED=2 pytest tests/fuzz/test_fuzz_api.py`` runs longer and with other inputs.
"""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import os
import socket
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import schemathesis
from fastapi.routing import APIRoute
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as seeded
from hypothesis.errors import Unsatisfiable
from PIL import Image
from schemathesis.generation import GenerationMode
from schemathesis.generation.case import Case
from schemathesis.python.asgi import get_client
from schemathesis.specs.openapi import checks

from gss.api.app import create_app
from gss.device.line_address import parse_line_address
from gss.domain.errors import BadInput
from gss.operations.jobs import JobRequest
from gss.settings import Settings
from gss.wiring.build import build

EXAMPLES = int(os.environ.get("GSS_FUZZ_EXAMPLES", "4"))
SEED = int(os.environ.get("GSS_FUZZ_SEED", "1"))
ENDLESS_ROUTES = ("/api/stream", "/api/rerun/live")
"""Routes with endless responses. The test client disconnects after the first part of the body."""
OPEN_LINK = "POST /api/link/open"
CHECKS = [
    schemathesis.checks.not_a_server_error,
    checks.status_code_conformance,
    checks.content_type_conformance,
    checks.response_schema_conformance,
]
EXCLUDED_CHECKS = {
    OPEN_LINK: [schemathesis.checks.not_a_server_error],  # the route returns 503 if no device responds
    # The check validates each event, but the schema describes the whole body.
    "GET /api/stream": [checks.response_schema_conformance],
}
MAX_RESPONSE_S = 60
ADDRESS = "http://localhost"
WITHOUT_SESSION = (
    "/api/session",
    "/api/session/password",
    "/api/setup",
    "/api/password-links",
    "/api/password-links/check",
)
SignIn = Callable[..., dict[str, str]]

pytestmark = pytest.mark.timeout(MAX_RESPONSE_S * 10)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, signed_in: SignIn) -> Iterator[tuple[Any, Any, Any]]:
    """Yield services, schema and client. The job thread is blocked, so expensive jobs are queued but do not run."""
    services = build(Settings(data=tmp_path_factory.mktemp("fuzzed"), password_memory_kib=8, password_passes=1))
    app, release = create_app(services), threading.Event()

    async def requests_only(scope: Any, receive: Any, send: Any) -> None:
        """Ignore lifespan events: schemathesis would stop the application after each test, but the TestClient starts and
        stops it once.
        """
        if scope["type"] == "lifespan":
            raise NotImplementedError  # an ASGI application without lifespan events raises this
        await (first_part_only(app) if scope["path"] in ENDLESS_ROUTES else app)(scope, receive, send)

    with TestClient(app, base_url=ADDRESS) as client, get_client(requests_only) as session:
        create_records(client, signed_in(services))
        services.base.jobs.begin("check-store", "hold", JobRequest(), lambda _run: {"held": release.wait()})
        try:
            yield services, schemathesis.openapi.from_dict(app.openapi()), session
        finally:
            services.base.jobs._pool.shutdown(wait=False, cancel_futures=True)
            release.set()


def first_part_only(app: Any) -> Any:
    """Wrap the application for a client that disconnects after the first part of a response body."""

    async def disconnecting_app(scope: Any, receive: Any, send: Any) -> None:
        disconnected = asyncio.Event()

        async def receive_first() -> Any:
            if not disconnected.is_set():
                message = await receive()
                if message["type"] == "http.disconnect" or message.get("body") or message.get("more_body"):
                    return message
                if not requested.is_set():
                    requested.set()
                    return message
            await disconnected.wait()
            return {"type": "http.disconnect"}

        async def send_first(message: Any) -> None:
            if disconnected.is_set():
                return
            if message.get("body"):
                message = {**message, "more_body": False}
                disconnected.set()
            await send(message)

        requested = asyncio.Event()
        await app(scope, receive_first, send_first)

    return disconnecting_app


@pytest.fixture(scope="module")
def peers() -> Iterator[tuple[str, str]]:
    """Host and port of a silent listener, and of a closed port."""
    with socket.create_server(("127.0.0.1", 0)) as silent, socket.create_server(("127.0.0.1", 0)) as closed:
        ports = [listener.getsockname()[1] for listener in (silent, closed)]
        closed.close()
        yield f"127.0.0.1:{ports[0]}", f"127.0.0.1:{ports[1]}"


def on_loopback(text: str, peers: tuple[str, str]) -> str:
    """Return an address derived from any text, valid or not. It opens only the ports of this test."""
    silent, closed = peers
    candidates = [
        text,
        f"socket://{silent}{text}",
        f"rfc2217://{closed}{text}",
        f"socket://{text}@{silent}",
        f"socket://{closed}",
    ]
    url = candidates[len(text) % len(candidates)]
    try:
        address = parse_line_address(url)
    except BadInput:
        return url
    return f"socket://{silent}" if address.is_device else url


def create_records(client: TestClient, headers: dict[str, str]) -> None:
    """Create one record of each kind that users create, so that records with number 1 exist."""
    sky = io.BytesIO()
    Image.new("L", (64, 64)).save(sky, "png")
    rows = "id,ra,dec,v\n" + "".join(f"{i},{i * 12},{i},3\n" for i in range(1, 30))
    procedure = {"text": "# s\n\n## a: Send\n```command\nGET_STATUS\n```\n"}
    responses = [
        client.post("/api/frames/import", files={"file": ("a.png", sky.getvalue())}, headers=headers),
        client.post(
            "/api/catalogues/sources",
            files={"file": ("a.csv", rows.encode())},
            data={"mapping": json.dumps({"epoch_jyear": 2000, "frame": "icrs"})},
            headers=headers,
        ),
        client.post("/api/procedures", json=procedure, headers=headers),
        client.post("/api/stations", json={"name": "s", "latitude_deg": 1, "longitude_deg": 2}, headers=headers),
        client.post("/api/tables", json={"kind": "parameters", "name": "own", "profile": "cubestar"}, headers=headers),
    ]
    assert [response.status_code for response in responses] == [201] * len(responses), [
        response.text for response in responses
    ]


def routes() -> list[str]:
    """Return method and path of each operation."""
    with tempfile.TemporaryDirectory() as folder:
        declared = [r for r in create_app(build(Settings(data=Path(folder)))).routes if isinstance(r, APIRoute)]
    return [f"{method} {r.path}" for r in declared if r.include_in_schema for method in sorted(r.methods)]


ROUTES = routes()


def test_every_operation_of_the_document_is_tested(server: tuple[Any, Any, Any]) -> None:
    """The routes of the tests below are the operations of the API's document."""
    operations = server[1].raw_schema["paths"].items()
    assert sorted(ROUTES) == sorted(f"{m.upper()} {path}" for path, methods in operations for m in methods)


@pytest.mark.parametrize("route", ROUTES)
def test_a_route_responds_to_any_input_as_declared(
    route: str, server: tuple[Any, Any, Any], signed_in: SignIn, peers: tuple[str, str]
) -> None:
    """Each route responds within a minute, with a declared status and the declared schema, and never with status 500."""
    services, schema, session = server
    session.headers.update(signed_in(services, name=f"admin of {route}") | {"Host": "localhost"})
    method, path = route.split(" ", 1)
    operation = schema[path][method]
    for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE):
        # A route without input, or with unrestricted text, has no invalid input.
        with contextlib.suppress(Unsatisfiable):
            _send_requests(route, operation, mode, session, peers)
    services.line.link.close()


def _send_requests(route: str, operation: Any, mode: GenerationMode, session: Any, peers: tuple[str, str]) -> None:
    """Send generated requests to a route and check the responses."""
    if mode is GenerationMode.NEGATIVE and not (operation.query or operation.body or operation.path_parameters):
        return

    @seeded(SEED)
    @settings(
        max_examples=EXAMPLES,
        deadline=None,
        database=None,
        phases=(Phase.explicit, Phase.generate, *([Phase.shrink] if EXAMPLES > 50 else [])),
        suppress_health_check=list(HealthCheck),
    )
    @given(operation.as_strategy(generation_mode=mode))
    def response_is_as_declared(case: Case) -> None:
        if route == OPEN_LINK and isinstance(case.body, dict) and isinstance(case.body.get("url"), str):
            case.body["url"] = on_loopback(case.body["url"], peers)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            response = case.call(base_url=ADDRESS, session=session, timeout=MAX_RESPONSE_S)
        case.validate_response(
            response, checks=[check for check in CHECKS if check not in EXCLUDED_CHECKS.get(route, [])]
        )
        assert response.status_code in (*range(500), 503), "the server failed"
        assert response.status_code != 401 or operation.path in WITHOUT_SESSION, (
            "the request had no session, so nothing was tested"
        )

    response_is_as_declared()
