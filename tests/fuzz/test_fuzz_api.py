"""Every route of the API meets requests made from its own description: no defect, no hang, answers as described.

The description is the application's OpenAPI; schemathesis makes requests that follow it and requests that break it. Bounded and the
same in every run; ``GSS_FUZZ_EXAMPLES=500 GSS_FUZZ_SEED=2 pytest tests/fuzz/test_fuzz_api.py`` runs longer and with other inputs.
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
ENDLESS = ("/api/stream", "/api/rerun/live")
"""Their clients here hang up after the first piece."""
OPEN_LINK = "POST /api/link/open"
HELD = [
    schemathesis.checks.not_a_server_error,
    checks.status_code_conformance,
    checks.content_type_conformance,
    checks.response_schema_conformance,
]
NOT_HELD = {
    OPEN_LINK: [schemathesis.checks.not_a_server_error],  # 503 is its answer where no device answers
    "GET /api/stream": [
        checks.response_schema_conformance
    ],  # it is tried on each event, and described for the whole body
}
MAX_ANSWER_S = 60
ADDRESS = "http://localhost"
WITHOUT_SESSION = (
    "/api/session",
    "/api/session/password",
    "/api/setup",
    "/api/password-links",
    "/api/password-links/check",
)
SignIn = Callable[..., dict[str, str]]

pytestmark = pytest.mark.timeout(MAX_ANSWER_S * 10)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, signed_in: SignIn) -> Iterator[tuple[Any, Any, Any]]:
    """Services, schema and a client. The job thread waits, so that hours of work are only queued."""
    services = build(Settings(data=tmp_path_factory.mktemp("fuzzed"), password_memory_kib=8, password_passes=1))
    app, release = create_app(services), threading.Event()

    async def requests_only(scope: Any, receive: Any, send: Any) -> None:
        """schemathesis stops an application after each test; ours is started and stopped once, by the TestClient."""
        if scope["type"] == "lifespan":
            raise NotImplementedError  # how an application says that it has no lifespan
        await (first_piece(app) if scope["path"] in ENDLESS else app)(scope, receive, send)

    with TestClient(app, base_url=ADDRESS) as client, get_client(requests_only) as session:
        furnish(client, signed_in(services))
        services.base.jobs.begin("check-store", "hold", JobRequest(), lambda _run: {"held": release.wait()})
        try:
            yield services, schemathesis.openapi.from_dict(app.openapi()), session
        finally:
            services.base.jobs._pool.shutdown(wait=False, cancel_futures=True)
            release.set()


def first_piece(app: Any) -> Any:
    """The application for a client that hangs up after the first piece of a body."""

    async def hangs_up(scope: Any, receive: Any, send: Any) -> None:
        gone = asyncio.Event()

        async def receive_first() -> Any:
            if not gone.is_set():
                message = await receive()
                if message["type"] == "http.disconnect" or message.get("body") or message.get("more_body"):
                    return message
                if not requested.is_set():
                    requested.set()
                    return message
            await gone.wait()
            return {"type": "http.disconnect"}

        async def send_first(message: Any) -> None:
            if gone.is_set():
                return
            if message.get("body"):
                message = {**message, "more_body": False}
                gone.set()
            await send(message)

        requested = asyncio.Event()
        await app(scope, receive_first, send_first)

    return hangs_up


@pytest.fixture(scope="module")
def peers() -> Iterator[tuple[str, str]]:
    """Host and port where a silent program listens, and where none does."""
    with socket.create_server(("127.0.0.1", 0)) as silent, socket.create_server(("127.0.0.1", 0)) as closed:
        ports = [listener.getsockname()[1] for listener in (silent, closed)]
        closed.close()
        yield f"127.0.0.1:{ports[0]}", f"127.0.0.1:{ports[1]}"


def on_loopback(text: str, peers: tuple[str, str]) -> str:
    """An address that opens nothing but the test's own ports, made from any text: valid, nearly valid, or not at all."""
    silent, closed = peers
    made = [
        text,
        f"socket://{silent}{text}",
        f"rfc2217://{closed}{text}",
        f"socket://{text}@{silent}",
        f"socket://{closed}",
    ]
    url = made[len(text) % len(made)]
    try:
        address = parse_line_address(url)
    except BadInput:
        return url
    return f"socket://{silent}" if address.is_device else url


def furnish(client: TestClient, headers: dict[str, str]) -> None:
    """One thing of each kind that a person brings, so that number 1 is there."""
    sky = io.BytesIO()
    Image.new("L", (64, 64)).save(sky, "png")
    rows = "id,ra,dec,v\n" + "".join(f"{i},{i * 12},{i},3\n" for i in range(1, 30))
    stack = {"name": "s", "steps": [{"command": "GET_STATUS"}]}
    made = [
        client.post("/api/frames/import", files={"file": ("a.png", sky.getvalue())}, headers=headers),
        client.post(
            "/api/catalogues/sources",
            files={"file": ("a.csv", rows.encode())},
            data={"mapping": json.dumps({"epoch_jyear": 2000, "frame": "icrs"})},
            headers=headers,
        ),
        client.post("/api/stacks", json=stack, headers=headers),
        client.post("/api/stations", json={"name": "s", "latitude_deg": 1, "longitude_deg": 2}, headers=headers),
        client.post("/api/tables", json={"kind": "parameters", "name": "own", "profile": "cubestar"}, headers=headers),
    ]
    assert [answer.status_code for answer in made] == [201] * len(made), [answer.text for answer in made]


def routes() -> list[str]:
    """Method and path of each operation."""
    with tempfile.TemporaryDirectory() as folder:
        described = create_app(build(Settings(data=Path(folder)))).openapi()
    return [f"{method.upper()} {path}" for path, operations in described["paths"].items() for method in operations]


@pytest.mark.parametrize("route", routes())
def test_a_route_answers_any_input_as_it_declares(
    route: str, server: tuple[Any, Any, Any], signed_in: SignIn, peers: tuple[str, str]
) -> None:
    """No status 500, nothing undeclared, no answer of another shape, and every answer within a minute."""
    services, schema, session = server
    session.headers.update(signed_in(services, name=f"admin of {route}") | {"Host": "localhost"})
    method, path = route.split(" ", 1)
    operation = schema[path][method]
    for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE):
        with contextlib.suppress(
            Unsatisfiable
        ):  # a route without input, or with unrestricted text, has no invalid input
            _ask(route, operation, mode, session, peers)
    services.line.link.close()


def _ask(route: str, operation: Any, mode: GenerationMode, session: Any, peers: tuple[str, str]) -> None:
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
    def holds(case: Case) -> None:
        if route == OPEN_LINK and isinstance(case.body, dict) and isinstance(case.body.get("url"), str):
            case.body["url"] = on_loopback(case.body["url"], peers)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            response = case.call(base_url=ADDRESS, session=session, timeout=MAX_ANSWER_S)
        case.validate_response(response, checks=[check for check in HELD if check not in NOT_HELD.get(route, [])])
        assert response.status_code in (*range(500), 503), "a defect"
        assert response.status_code != 401 or operation.path in WITHOUT_SESSION, (
            "the request had no session, so nothing was tested"
        )

    holds()
