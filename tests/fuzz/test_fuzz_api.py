"""Every route of the API meets requests made from its own description: no defect, no hang, answers as described.

The description is the application's OpenAPI; schemathesis makes requests that follow it and requests that break it. Bounded and the
same in every run; ``GSS_FUZZ_EXAMPLES=500 GSS_FUZZ_SEED=2 pytest tests/fuzz/test_fuzz_api.py`` looks longer and elsewhere.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
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
from gss.settings import Settings
from gss.wiring import build

EXAMPLES = int(os.environ.get("GSS_FUZZ_EXAMPLES", "4"))
SEED = int(os.environ.get("GSS_FUZZ_SEED", "1"))
LEFT_OUT = {
    "GET /api/stream": "never ends; tests/system/test_stream_and_shell.py reads it",
    "GET /api/rerun/live": "never ends; tests of the live recording read it",
    "POST /api/link/open": "opens any port of this machine and any host that is named; tests/api has its bad input",
}
HELD = [
    schemathesis.checks.not_a_server_error,
    checks.status_code_conformance,
    checks.content_type_conformance,
    checks.response_schema_conformance,
]
LONGEST_ANSWER_S = 60
ADDRESS = "http://localhost"
WITHOUT_SESSION = (
    "/api/session",
    "/api/session/password",
    "/api/setup",
    "/api/password-links",
    "/api/password-links/check",
)
SignIn = Callable[..., dict[str, str]]

pytestmark = pytest.mark.timeout(LONGEST_ANSWER_S * 10)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, signed_in: SignIn) -> Iterator[tuple[Any, Any, Any]]:
    """Services, schema and a client. The job thread waits, so that hours of work are only queued."""
    services = build(Settings(data=tmp_path_factory.mktemp("fuzzed"), password_memory_kib=8, password_passes=1))
    app, release = create_app(services), threading.Event()

    async def requests_only(scope: Any, receive: Any, send: Any) -> None:
        """schemathesis stops an application after each test; ours is started and stopped once, by the TestClient."""
        if scope["type"] == "lifespan":
            raise NotImplementedError  # how an application says that it has no lifespan
        await app(scope, receive, send)

    with TestClient(app, base_url=ADDRESS) as client, get_client(requests_only) as session:
        furnish(client, signed_in(services))
        services.jobs.submit("hold", "hold", {}, lambda _progress: {"held": release.wait()})
        try:
            yield services, schemathesis.openapi.from_dict(app.openapi()), session
        finally:
            services.jobs._pool.shutdown(wait=False, cancel_futures=True)
            release.set()


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
        client.post("/api/tables", json={"kind": "parameters", "name": "own", "profile": "cubestar"}, headers=headers),
    ]
    assert [answer.status_code for answer in made] == [201] * len(made), [answer.text for answer in made]


def routes() -> list[str]:
    """Method and path of each operation."""
    described = json.loads((Path(__file__).parents[2] / "web" / "openapi.json").read_text())
    every = [f"{method.upper()} {path}" for path, operations in described["paths"].items() for method in operations]
    return [route for route in every if route not in LEFT_OUT]


@pytest.mark.parametrize("route", routes())
def test_a_route_answers_whatever_it_is_asked_as_it_describes(
    route: str, server: tuple[Any, Any, Any], signed_in: SignIn
) -> None:
    """No status 500, nothing undeclared, no answer of another shape, and every answer within a minute."""
    services, schema, session = server
    session.headers.update(signed_in(services, name=f"admin of {route}") | {"Host": "localhost"})
    method, path = route.split(" ", 1)
    operation = schema[path][method]
    for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE):
        with contextlib.suppress(Unsatisfiable):  # a route that takes nothing, or any word, cannot be asked wrongly
            _ask(operation, mode, session)


def _ask(operation: Any, mode: GenerationMode, session: Any) -> None:
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
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            response = case.call(base_url=ADDRESS, session=session, timeout=LONGEST_ANSWER_S)
        case.validate_response(response, checks=HELD)
        assert response.status_code != 401 or operation.path in WITHOUT_SESSION, (
            "asked without a session: nothing was tried"
        )

    holds()
