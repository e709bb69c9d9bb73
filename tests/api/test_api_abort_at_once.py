"""ABORT over HTTP while other requests use all resources."""

from __future__ import annotations

import asyncio
import sqlite3
import threading
import time
from collections.abc import Callable
from contextlib import closing
from datetime import timedelta
from typing import Any

import anyio.to_thread
from fastapi import FastAPI

from gss.operations.clock import utc_now
from gss.store.models import ApiToken


async def post_until_response(app: FastAPI, path: str, headers: dict[str, str]) -> tuple[int, asyncio.Task[None]]:
    """Return the status of a POST when its response is complete, and the task that still writes its audit entry."""
    final_status: asyncio.Future[int] = asyncio.get_running_loop().create_future()
    status = 0

    async def send(message: Any) -> None:
        nonlocal status
        status = message.get("status", status)
        if message["type"] == "http.response.body" and not message.get("more_body") and not final_status.done():
            final_status.set_result(status)

    async def receive() -> Any:
        return {"type": "http.request", "body": b"", "more_body": False}

    encoded = [(b"host", b"localhost"), *((k.lower().encode(), v.encode()) for k, v in headers.items())]
    scope = {"type": "http", "http_version": "1.1", "method": "POST", "path": path, "raw_path": path.encode()}
    scope |= {"query_string": b"", "headers": encoded, "client": ("127.0.0.1", 1), "server": ("localhost", 80)}
    task = asyncio.create_task(app({**scope, "scheme": "http", "root_path": ""}, receive, send))
    return await final_status, task


def test_abort_waits_for_no_other_thread(app: FastAPI, signed_in: Callable[..., dict[str, str]]) -> None:
    """The server answers ABORT while every request thread is in use, also for a user who is not in the cache."""
    headers = signed_in(app.state.services, "viewer", "vera")

    async def run() -> int:
        release = threading.Event()
        limiter = anyio.to_thread.current_default_thread_limiter()
        limiter.total_tokens = 2
        async with asyncio.timeout(30), asyncio.TaskGroup() as others:
            for _ in range(6):
                others.create_task(anyio.to_thread.run_sync(release.wait))
            try:
                status, audit_task = await post_until_response(app, "/api/commands/abort", headers)
            finally:
                release.set()
            await audit_task
        return status

    assert asyncio.run(run()) == 409  # the link is down


def test_abort_of_a_token_waits_for_no_write(app: FastAPI) -> None:
    """ABORT with a token does not wait for the write lock that another connection holds.

    The token was last used two minutes ago, so its use must be stored. SQLite waits 5 s for the lock.
    """
    services = app.state.services
    token = services.accounts.accounts.tokens.add("night run", "operator", 1, by="test")
    with services.base.database.unit_of_work() as session:
        last_used = session.get_one(ApiToken, token.row.id).last_used = utc_now() - timedelta(minutes=2)

    async def run(release: Callable[[], None]) -> tuple[int, float]:
        start_s = time.monotonic()
        status, audit_task = await post_until_response(
            app, "/api/commands/abort", {"Authorization": f"Bearer {token.key}"}
        )
        took_s = time.monotonic() - start_s
        release()
        await audit_task
        return status, took_s

    with closing(sqlite3.connect(services.base.settings.data / "gss.db", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        status, took_s = asyncio.run(run(lambda: other.execute("ROLLBACK")))
    assert status == 409  # the link is down
    assert took_s < 3
    with services.base.database.unit_of_work() as session:
        assert session.get_one(ApiToken, token.row.id).last_used == last_used
