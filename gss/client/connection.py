"""HTTP connection to the server: sends the token, raises errors as exceptions, and retries reads while the server is
unavailable."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path

import httpx2

from gss.client.errors import ClientError, NotAllowed, ServerAway
from gss.client.records import Json

RETRY_S = 0.5
UNAVAILABLE = (502, 503, 504)
"""Status codes of a proxy, or of a server that is starting or stopping."""


class ServerConnection:
    """Requests to ``address`` + "/api". ``reconnect_s``: time for which reads are retried while the server is
    unavailable."""

    def __init__(self, address: str, token: str, timeout_s: float, reconnect_s: float) -> None:
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._http = httpx2.Client(base_url=f"{address.rstrip('/')}/api", headers=headers, timeout=timeout_s)
        self._address, self._reconnect_s = address, reconnect_s

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def get(self, path: str, **query: Json) -> Json:
        """Return the JSON response of a path. The request is retried while the server is unavailable."""
        return self.download(path, **query).json()

    def download(self, path: str, **query: Json) -> httpx2.Response:
        """Return the response of a path. The request is retried while the server is unavailable."""
        deadline_s = time.monotonic() + self._reconnect_s
        while True:
            try:
                return self._response_of(lambda: self._http.get(path, params=query))
            except ServerAway:
                if time.monotonic() > deadline_s:
                    raise
            time.sleep(RETRY_S)

    def post(self, path: str, body: Mapping[str, Json] | None = None) -> Json:
        """Send a change once and return the JSON response; None if the response is empty."""
        response = self._response_of(lambda: self._http.post(path, json=body))
        return response.json() if response.content else None

    def upload(self, path: str, file: Path, form: Mapping[str, str]) -> Json:
        """Send a file once, as the field ``file`` of a form."""
        with file.open("rb") as content:
            return self._response_of(
                lambda: self._http.post(path, files={"file": (file.name, content)}, data=form)
            ).json()

    def _response_of(self, request: Callable[[], httpx2.Response]) -> httpx2.Response:
        try:
            response = request()
        except httpx2.TransportError as error:
            raise ServerAway(f"{self._address} does not respond: {error or type(error).__name__}.") from error
        if response.is_success:
            return response
        kind = (
            NotAllowed
            if response.status_code in (401, 403)
            else ServerAway
            if response.status_code in UNAVAILABLE
            else ClientError
        )
        raise kind(_error_text(response), response.status_code)


def _error_text(response: httpx2.Response) -> str:
    """Return the server's error message, or the status if the response is not from GSS."""
    try:
        problem = response.json()
        facts = "; ".join(f"{part} {problem[part]}" for part in ("expected", "got") if problem[part])
        sentences = (problem["message"], f"{facts[:1].upper()}{facts[1:]}." if facts else "", problem["hint"])
        return " ".join(text for text in sentences if text)
    except (ValueError, KeyError, TypeError):
        return f"The server responded with {response.status_code} {response.reason_phrase}."
