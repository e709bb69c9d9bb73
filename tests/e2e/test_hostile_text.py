"""Markup in texts that users, files and unauthenticated clients can store is shown as text on every page."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from typing import Any

import httpx2
import numpy as np
import pytest
from PIL import Image

from gss.instruments.package_source import write_zip
from gss.instruments.registry import shipped_registry
from tools.hostile_texts import ATTEMPTED, LATER, MARKUP, STORED

pytestmark = [pytest.mark.browser, pytest.mark.timeout(600)]
INJECTED = "() => [window.injected ?? 0, document.querySelectorAll('.injected').length]"
SHOWN = """() => document.body.innerText.includes('class=injected')
  || [...document.querySelectorAll('[title], [value]')].some((e) => (e.title + (e.value ?? '')).includes('class=injected'))"""
PAGES = [
    "/live", "/commands", "/telemetry", "/telemetry/derived", "/frames", "/frames/{frame}",
    "/frames/lists",
    "/catalogues", "/catalogues/new", "/catalogues/design", "/calibration", "/sheet", "/campaigns", "/contacts", "/contacts/1",
    "/instruments", "/instruments?name=hostile", "/procedures", "/passes", "/passes?show=stations", "/passes?show=plans", "/fleet",
    "/views", "/views/1", "/admin", "/admin?show=users", "/admin?show=tokens", "/admin?show=audit", "/admin?show=storage",
    "/admin?show=health",
]  # fmt: skip
SHOW_TEXT = 12
"""Number of pages that must show a stored text, so that the test does not look at empty pages."""
QUERIES = [
    "/commands?command=", "/telemetry?plot=", "/frames?name=", "/contacts?contact=", "/campaigns?job=", "/admin?show=audit&who=",
    "/admin?show=", "/instruments?name=", "/catalogues/new?name=", "/rerun?frames=", "/live#", "/",
]  # fmt: skip


def picture() -> bytes:
    """Return a small valid image."""
    out = io.BytesIO()
    Image.fromarray(np.zeros((64, 64), np.uint8)).save(out, "PNG")
    return out.getvalue()


def package() -> bytes:
    """Return an instrument package with markup in the texts of its files."""
    files = dict(shipped_registry().get("aim").files)
    about = files["instrument.yaml"].decode().splitlines()
    quoted = json.dumps(MARKUP)
    about = [f"title: {quoted}" if line.startswith("title:") else line for line in about]
    about = ["id: hostile" if line.startswith("id:") else line for line in about]
    files |= {
        "instrument.yaml": "\n".join(about).encode(),
        "procedures/first-light.md": f"# {MARKUP}\n\n{MARKUP}\n".encode(),
    }
    return write_zip("hostile", files)


@pytest.fixture(scope="module")
def frame_with_markup(served: Any, signed_in: Callable[..., dict[str, str]]) -> int:
    """Store the markup in every text that the API accepts and return the id of an imported frame."""
    served.until("/link", lambda link: link["connected"] and link["dictionary_match"])
    other = {**signed_in(served.folder, "admin", "other")}
    with httpx2.Client(base_url=f"{served.address}/api", headers=served.headers, timeout=60) as client:
        sent = client.post("/frames/import", files={"file": (MARKUP, picture(), "image/png")})
        ids = {"frame": sent.raise_for_status().json()["id"]}
        for path, name, data, fields in (
            (
                "/catalogues/sources",
                f"{MARKUP}.csv",
                b"ra,dec,mag\n1,2,3\n",
                {"name": MARKUP, "mapping": '{"epoch_jyear": 2016, "frame": "icrs"}'},
            ),
            ("/lists", f"{MARKUP}.csv", b"list,col_px,row_px,flux\n0,1,2,3\n", {"camera": "cubestar"}),
            ("/instruments", f"{MARKUP}.zip", package(), {}),
        ):
            reply = client.post(path, files={"file": (name, data)}, data=fields)
            assert reply.status_code < 300, (path, reply.text)
        for path in ("/attitudes/compare", "/frames/import", "/instruments/check"):
            reply = client.post(
                path, files={"file": (MARKUP, MARKUP.encode())}, data={"origin": "ground", "profile": MARKUP}
            )
            assert reply.status_code < 500, (path, reply.text)
        for method, path, body in STORED:
            reply = client.request(method, path, json=body)
            assert reply.status_code < 300, (path, reply.text)
            if path == "/procedures":
                started = client.post(f"/procedures/{reply.json()['id']}/start", json={})
                ids["run"] = started.raise_for_status().json()["id"]
        client.post("/authority/take")
        alarms = served.until("/alarms", lambda rows: [r for r in rows if r["field"] == "sensor_temperature_c"])
        ids["alarm"] = alarms[0]["id"]
        for method, path, body in (*ATTEMPTED, *LATER):
            headers = other if path.startswith("/authority/") else {}
            reply = client.request(method, path.format(**ids), json=body, headers=headers)
            assert reply.status_code < 500 or reply.status_code == 503, (path, reply.text)
    assert "class=injected" in json.dumps(served.ask("GET", "/audit?limit=100"))
    return int(ids["frame"])


def test_stored_markup_is_text_on_every_page(page: Any, frame_with_markup: int, follow: Any, at_rest: Any) -> None:
    """Stored markup creates no element and runs no script on any page. Many pages show it as text."""
    pages_with_text = []
    page.goto("/")
    at_rest(page)
    for path in PAGES:
        follow(page, path.format(frame=frame_with_markup))
        at_rest(page)
        assert page.evaluate(INJECTED) == [0, 0], path
        pages_with_text += [path] if page.evaluate(SHOWN) else []
    assert len(pages_with_text) >= SHOW_TEXT, pages_with_text


def test_markup_in_an_address_is_text(page: Any, served: Any, at_rest: Any) -> None:
    """Markup in the address of a page creates no element and runs no script."""
    served.until("/link", lambda link: link["connected"])
    for path in QUERIES:
        page.goto(path + MARKUP.replace('"', "%22").replace("<", "%3C").replace(">", "%3E").replace(" ", "%20"))
        at_rest(page)
        assert page.evaluate(INJECTED) == [0, 0], path
