"""Every free text of a request is stored as markup by the browser test, or is on a list with the reason."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest
from fastapi.testclient import TestClient

from tools.hostile_texts import ATTEMPTED, CAMERA_FIELDS, LATER, NOT_TRIED, STORED, marked_fields

Path = tuple[str, ...]
FORMS = (
    "Body_import_frame",
    "Body_solve_lists",
    "Body_add_source",
    "Body_compare_attitudes",
    "Body_add_instrument",
    "Body_check_package",
)
"""Forms that the browser test sends with markup in the names of the files and in the other fields."""
SAME_AS = {"ViewChangeIn": "ViewRequest", "ProcedureChangeIn": "ProcedureTextIn"}
"""Models whose fields are stored and shown like those of another model."""


@pytest.fixture(scope="module")
def schema(client: TestClient) -> Any:
    """The API's description."""
    return client.get("/api/openapi.json").json()


def free_texts(
    part: Any, models: dict[str, Any], model: str, path: Path = (), inside: Path = ()
) -> Iterator[tuple[Path, str]]:
    """Yield the path and ``Model.field`` of each text without pattern or fixed values."""
    if "$ref" in part:
        name = part["$ref"].rsplit("/", 1)[1]
        if name not in inside:
            yield from free_texts(models[name], models, name, path, (*inside, name))
        return
    for choice in (*part.get("anyOf", ()), *part.get("oneOf", ()), *part.get("allOf", ())):
        yield from free_texts(choice, models, model, path, inside)
    fixed = {"enum", "const", "pattern", "format"} & set(part)
    if part.get("type") == "string" and (not fixed or part.get("format") == "binary"):
        yield path, f"{model}.{path[-1] if path else ''}"
    for name, field in part.get("properties", {}).items():
        yield from free_texts(field, models, model, (*path, name), inside)
    for nested in (part.get("items"), part.get("additionalProperties")):
        if isinstance(nested, dict):
            yield from free_texts(nested, models, model, path, inside)


def texts_of_routes(schema: Any) -> dict[tuple[str, str], list[tuple[Path, str]]]:
    """Return the free texts of the body of each operation, by method and path."""
    models = schema["components"]["schemas"]
    return {
        (method.upper(), path.removeprefix("/api")): [
            found
            for content in operation["requestBody"]["content"].values()
            for found in free_texts(content["schema"], models, "")
        ]
        for path, operations in schema["paths"].items()
        for method, operation in operations.items()
        if "requestBody" in operation
    }


def tried(routes: dict[tuple[str, str], list[tuple[Path, str]]]) -> set[str]:
    """Return ``Model.field`` of each text that a request of the browser test contains."""
    fields: set[str] = set()
    for method, address, body in (*STORED, *ATTEMPTED, *LATER):
        matches = (r for r in routes if r[0] == method and re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", r[1]), address))
        route = min(matches, key=lambda match: match[1].count("{"))
        for marked in marked_fields(body):
            path = marked
            while path and path not in {known for known, _ in routes[route]}:
                path = path[:-1]
            assert path, f"{method} {address} has no text {marked}"
            fields |= {name for known, name in routes[route] if known == path}
    return fields


def test_every_free_text_is_tried_as_markup_or_has_a_reason(schema: Any) -> None:
    """A new text field of the API is added to ``tools/hostile_texts.py``: to a request, or to the list with a reason."""
    routes = texts_of_routes(schema)
    names = {name for texts in routes.values() for _, name in texts}
    done = tried(routes)
    for name in sorted(names - done - set(NOT_TRIED)):
        model, _, field = name.partition(".")
        same = next((f"{other}.{field}" for start, other in SAME_AS.items() if model.startswith(start)), "")
        assert same in done or model.startswith(FORMS) or field in CAMERA_FIELDS, (
            f"{name} has neither markup nor a reason"
        )
    assert set(NOT_TRIED) <= names - done, sorted(set(NOT_TRIED) - (names - done))
