"""ABORT over HTTP while everybody else wants something."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Any

import anyio.to_thread
from fastapi import FastAPI


async def asked(app: FastAPI, path: str, headers: dict[str, str]) -> tuple[int, asyncio.Task[None]]:
    """Status of a POST as soon as its answer is whole, and what still goes on for it: the row on the record."""
    found: asyncio.Future[int] = asyncio.get_running_loop().create_future()
    status = 0

    async def send(message: Any) -> None:
        nonlocal status
        status = message.get("status", status)
        if message["type"] == "http.response.body" and not message.get("more_body") and not found.done():
            found.set_result(status)

    async def receive() -> Any:
        return {"type": "http.request", "body": b"", "more_body": False}

    told = [(b"host", b"localhost"), *((k.lower().encode(), v.encode()) for k, v in headers.items())]
    scope = {"type": "http", "http_version": "1.1", "method": "POST", "path": path, "raw_path": path.encode()}
    scope |= {"query_string": b"", "headers": told, "client": ("127.0.0.1", 1), "server": ("localhost", 80)}
    task = asyncio.create_task(app({**scope, "scheme": "http", "root_path": ""}, receive, send))
    return await found, task


def test_abort_waits_for_no_thread_of_others(app: FastAPI, signed_in: Callable[..., dict[str, str]]) -> None:
    """Every thread for requests is taken and more wait for one: ABORT is answered, also of somebody who was not known yet."""
    headers = signed_in(app.state.services, "viewer", "vera")

    async def run() -> int:
        release = threading.Event()
        limiter = anyio.to_thread.current_default_thread_limiter()
        limiter.total_tokens = 2
        async with asyncio.timeout(30), asyncio.TaskGroup() as others:
            for _ in range(6):
                others.create_task(anyio.to_thread.run_sync(release.wait))
            try:
                status, rest = await asked(app, "/api/commands/abort", headers)
            finally:
                release.set()
            await rest
        return status

    assert asyncio.run(run()) == 409  # the line is down
