"""Serve the files of the web pages. Each file is read and compressed once. Browsers cache the files in ``assets/``
permanently, because their names contain a hash."""

from __future__ import annotations

import gzip
import hashlib
import mimetypes
from dataclasses import dataclass
from pathlib import Path

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

INDEX = "index.html"
HASHED_FOLDER = "assets/"
CACHE_PERMANENTLY = "public, max-age=31536000, immutable"
REVALIDATE = "no-cache"
COMPRESSED_TYPES = ("text/", "application/json", "image/svg+xml", "text/javascript", "application/javascript")
MIN_COMPRESSED_BYTES = 1024
NO_INDEX_FALLBACK = ("api/", HASHED_FOLDER, "fonts/")


@dataclass(frozen=True)
class File:
    """Content and headers of a page file. ``gzipped``: None if compression is not worthwhile."""

    content: bytes
    gzipped: bytes | None
    etag: str
    media_type: str
    cache: str


class Pages:
    """Serves the files of the last web build. Any other page path returns the index page, whose script does the
    routing. File names are looked up in a list, never on disk."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._built_ns = 0
        self._paths: dict[str, Path] = {}
        self._files: dict[str, File] = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a GET or HEAD request."""
        name = scope["path"].lstrip("/") or INDEX
        self._reload_if_rebuilt()
        if name not in self._paths:
            if name.startswith(NO_INDEX_FALLBACK) or "." in name.rsplit("/", 1)[-1]:
                raise HTTPException(404)
            name = INDEX
        if scope["method"] not in ("GET", "HEAD"):
            raise HTTPException(405, headers={"Allow": "GET, HEAD"})
        await _response(self._file(name), Headers(scope=scope), head=scope["method"] == "HEAD")(scope, receive, send)

    def _reload_if_rebuilt(self) -> None:
        """Reload the file list if the pages were rebuilt while the server runs."""
        built_ns = (self._folder / INDEX).stat().st_mtime_ns
        if built_ns != self._built_ns:
            files = {str(p.relative_to(self._folder)): p for p in self._folder.rglob("*") if p.is_file()}
            self._paths = {name: path for name, path in files.items() if not name.startswith(".")}
            self._files, self._built_ns = {}, built_ns

    def _file(self, name: str) -> File:
        file = self._files.get(name)
        if file is None:
            file = self._files[name] = read(self._paths[name], name)
        return file


def read(path: Path, name: str) -> File:
    """Read a file, compress it if worthwhile, and choose its cache policy from its folder."""
    content = path.read_bytes()
    media_type = mimetypes.guess_type(name)[0] or "application/octet-stream"
    gzipped = None
    if media_type.startswith(COMPRESSED_TYPES) and len(content) >= MIN_COMPRESSED_BYTES:
        gzipped = gzip.compress(content, 9, mtime=0)
    etag = hashlib.sha256(content).hexdigest()[:20]
    return File(content, gzipped, etag, media_type, CACHE_PERMANENTLY if name.startswith(HASHED_FOLDER) else REVALIDATE)


def _response(file: File, request_headers: Headers, *, head: bool) -> Response:
    use_gzip = file.gzipped is not None and "gzip" in request_headers.get("accept-encoding", "")
    etag = f'"{file.etag}{"-gz" if use_gzip else ""}"'
    headers = {"ETag": etag, "Cache-Control": file.cache}
    if file.gzipped is not None:
        headers["Vary"] = "Accept-Encoding"
    if etag in request_headers.get("if-none-match", ""):
        return Response(status_code=304, headers=headers)
    content = file.gzipped if use_gzip and file.gzipped is not None else file.content
    if use_gzip:
        headers["Content-Encoding"] = "gzip"
    if head:
        return Response(headers=headers | {"Content-Length": str(len(content))}, media_type=file.media_type)
    return Response(content, headers=headers, media_type=file.media_type)
