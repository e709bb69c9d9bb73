"""Page files and long responses: compressed, cached, and never read from disk by a name from a request."""

from __future__ import annotations

from pathlib import Path

import pytest
from starlette.applications import Starlette
from starlette.testclient import TestClient

from gss.api.files.compress import Compress
from gss.api.files.pages import Pages


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "web" / "assets").mkdir(parents=True)
    (tmp_path / "web" / "index.html").write_text("<h1>one page</h1>" + " " * 2000)
    (tmp_path / "web" / "assets" / "app-1a2b.js").write_text("let a = 1;\n" * 500)
    (tmp_path / "web" / "icon.svg").write_text("<svg/>")
    (tmp_path / "web" / ".built-from").write_text("secret")
    (tmp_path / "outside.txt").write_text("not yours")
    return tmp_path / "web"


@pytest.fixture
def pages(folder: Path) -> TestClient:
    app = Starlette()
    app.router.default = Pages(folder)
    return TestClient(app, raise_server_exceptions=False)


def test_hashed_files_are_immutable_and_compressed_on_request(pages):
    """Files with a hash in their name are cached as immutable. Each encoding has a separate ETag, and a cached one
    gives a 304.
    """
    packed = pages.get("/assets/app-1a2b.js", headers={"Accept-Encoding": "gzip"})
    plain = pages.get("/assets/app-1a2b.js", headers={"Accept-Encoding": "identity"})
    assert packed.headers["content-encoding"] == "gzip"
    assert "content-encoding" not in plain.headers
    assert packed.text == plain.text == "let a = 1;\n" * 500
    assert packed.headers["cache-control"] == "public, max-age=31536000, immutable"
    assert packed.headers["vary"] == plain.headers["vary"] == "Accept-Encoding"
    assert packed.headers["etag"] != plain.headers["etag"]
    again = pages.get(
        "/assets/app-1a2b.js", headers={"If-None-Match": packed.headers["etag"], "Accept-Encoding": "gzip"}
    )
    assert (again.status_code, again.content) == (304, b"")
    head = pages.head("/assets/app-1a2b.js", headers={"Accept-Encoding": "identity"})
    assert (head.headers["content-length"], head.content) == (str(len(plain.content)), b"")


def test_only_addresses_of_the_console_return_the_page(pages):
    """Routes of the console return the page, which is revalidated each time. Missing files and data are a 404."""
    for address in ("/", "/live", "/frames/12"):
        reply = pages.get(address)
        assert (reply.status_code, reply.headers["cache-control"]) == (200, "no-cache")
        assert "one page" in reply.text
    for address in (
        "/assets/gone.js",
        "/api/nothing",
        "/robots.txt",
        "/.built-from",
        "/../outside.txt",
        "/%2e%2e/outside.txt",
    ):
        assert pages.get(address).status_code == 404, address
    assert pages.post("/live").status_code == 405


def test_rebuilt_pages_are_served_at_once(pages, folder):
    """A running server shows a new build without a restart."""
    assert pages.get("/assets/app-9z.js").status_code == 404
    (folder / "assets" / "app-9z.js").write_text("new")
    (folder / "index.html").write_text("<h1>another page</h1>")
    assert pages.get("/assets/app-9z.js").text == "new"
    assert "another page" in pages.get("/live").text


def test_only_long_complete_responses_without_a_secret_are_compressed():
    """A long JSON response is compressed. Short responses, pictures, streams and the session response are not."""

    async def app(scope, receive, send):
        kind, size, pieces = scope["query_string"].decode().split(",")
        headers = [(b"content-type", kind.encode()), (b"content-length", str(int(size) * int(pieces)).encode())]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        for k in range(int(pieces)):
            await send({"type": "http.response.body", "body": b"x" * int(size), "more_body": k + 1 < int(pieces)})

    client = TestClient(Compress(app))

    def encoding(path: str, query: str, accepts: str = "gzip") -> str:
        reply = client.get(f"{path}?{query}", headers={"Accept-Encoding": accepts})
        size, pieces = (int(n) for n in query.split(",")[1:])
        assert reply.content == b"x" * size * pieces
        return reply.headers.get("content-encoding", "")

    assert encoding("/api/a", "application/json,5000,1") == "gzip"
    assert encoding("/api/a", "application/json,5000,1", "identity") == ""
    assert encoding("/api/a", "application/json,100,1") == ""
    assert encoding("/api/a", "image/png,5000,1") == ""
    assert encoding("/api/a", "application/json,5000,3") == ""
    assert encoding("/api/session", "application/json,5000,1") == ""
