"""Downloads of a file that is being written: the stated length equals the sent length."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import StreamingResponse
from fastapi.testclient import TestClient

from gss.api.files.cached import BLOCK_BYTES, file_download


def test_a_file_that_grows_while_it_is_sent_has_its_length_at_the_start(tmp_path: Path) -> None:
    """Bytes that are appended after the start of the response are not sent. The file has several blocks."""
    path = tmp_path / "contact-000001-000.raw"
    content = bytes(range(256)) * (BLOCK_BYTES // 128)
    path.write_bytes(content)
    app = FastAPI()

    @app.get("/file")
    def download() -> StreamingResponse:
        response = file_download(path)
        with path.open("ab") as file:
            file.write(b"x" * 100_000)
        return response

    reply = TestClient(app).get("/file")
    assert reply.headers["content-length"] == str(len(content))
    assert reply.content == content
