"""Markup in texts that users, files and unauthenticated clients can store is shown as text on every page."""

from __future__ import annotations

import io
import json
from typing import Any

import httpx2
import numpy as np
import pytest
from PIL import Image

pytestmark = [pytest.mark.browser, pytest.mark.timeout(600)]
MARKUP = '"><img src=x class=injected onerror="window.injected=1">'
INJECTED = "() => [window.injected ?? 0, document.querySelectorAll('.injected').length]"
SHOWN = """() => document.body.innerText.includes('class=injected')
  || [...document.querySelectorAll('[title], [value]')].some((e) => (e.title + (e.value ?? '')).includes('class=injected'))"""
PAGES = [
    "/live", "/commands", "/procedures", "/telemetry", "/frames", "/frames/{frame}", "/catalogues", "/catalogues/new",
    "/catalogues/design", "/calibration", "/campaigns", "/contacts", "/contacts/1", "/instruments", "/admin", "/admin?show=users",
    "/admin?show=tokens", "/admin?show=audit", "/admin?show=storage", "/admin?show=health",
]  # fmt: skip
QUERIES = [
    "/commands?command=", "/telemetry?plot=", "/frames?name=", "/contacts?contact=", "/campaigns?job=", "/admin?show=audit&who=",
    "/admin?show=", "/instruments?name=", "/catalogues/new?name=", "/rerun?frames=", "/live#", "/",
]  # fmt: skip


def picture() -> bytes:
    """Return a small valid image."""
    out = io.BytesIO()
    Image.fromarray(np.zeros((64, 64), np.uint8)).save(out, "PNG")
    return out.getvalue()


@pytest.fixture(scope="module")
def frame_with_markup(served: Any) -> int:
    """Store the markup in every text that the API accepts and return the id of an imported frame."""
    served.until("/link", lambda link: link["connected"] and link["dictionary_match"])
    text = f"# {MARKUP}\n\n{MARKUP}\n\n## send-1: {MARKUP}\n\n{MARKUP}\n\n```command\nGET_STATUS\n```\n"
    answers: dict[str, int] = {}
    with httpx2.Client(base_url=f"{served.address}/api", headers=served.headers, timeout=60) as client:
        for method, path, body in (
            ("POST", "/users", {"name": MARKUP, "role": "viewer"}),
            ("POST", "/tokens", {"name": MARKUP, "role": "viewer", "days": 1}),
            ("POST", "/procedures", {"text": text}),
            ("PUT", "/contacts/1/note", {"note": MARKUP}),
            ("PUT", "/telemetry/limits/set", {"name": "nominal", "note": MARKUP}),
            ("POST", "/session", {"name": MARKUP, "password": "wrong password"}),
            ("POST", "/link/open", {"url": MARKUP}),
            ("POST", "/commands", {"name": MARKUP, "arguments": {}}),
        ):
            answers[path] = client.request(method, path, json=body).status_code
        sent = client.post("/frames/import", files={"file": (MARKUP, picture(), "image/png")})
        answers["/frames/import"] = sent.status_code
        rows = b"ra,dec,mag\n1,2,3\n"
        sources = client.post("/catalogues/sources", files={"file": (MARKUP, rows, "text/csv")}, data={"name": MARKUP})
        answers["/catalogues/sources"] = sources.status_code
    assert all(code < 500 for code in answers.values()), answers
    assert sum(code < 300 for code in answers.values()) >= 5, answers
    assert "class=injected" in json.dumps(served.ask("GET", "/audit?limit=100"))
    return int(sent.json()["id"])


def test_stored_markup_is_text_on_every_page(page: Any, frame_with_markup: int, at_rest: Any) -> None:
    """Stored markup creates no element and runs no script on any page. At least three pages show it as text."""
    pages_with_text = []
    for path in PAGES:
        page.goto(path.format(frame=frame_with_markup))
        at_rest(page)
        assert page.evaluate(INJECTED) == [0, 0], path
        pages_with_text += [path] if page.evaluate(SHOWN) else []
    assert len(pages_with_text) >= 3, pages_with_text


def test_markup_in_an_address_is_text(page: Any, served: Any, at_rest: Any) -> None:
    """Markup in the address of a page creates no element and runs no script."""
    served.until("/link", lambda link: link["connected"])
    for path in QUERIES:
        page.goto(path + MARKUP.replace('"', "%22").replace("<", "%3C").replace(">", "%3E").replace(" ", "%20"))
        at_rest(page)
        assert page.evaluate(INJECTED) == [0, 0], path
