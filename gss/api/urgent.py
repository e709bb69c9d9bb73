"""Threads reserved for ABORT, because other requests can fill the shared thread pool. The identity of the caller is read on
separate threads, because the database can stop responding."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from starlette.requests import Request

ABORT = "/api/commands/abort"
T = TypeVar("T")
LOOKUP_S = 1.0
TURNS = 4
_THREADS = ThreadPoolExecutor(max_workers=4, thread_name_prefix="abort")
_LOOKUPS = ThreadPoolExecutor(max_workers=4, thread_name_prefix="abort caller")


async def run_urgent(call: Callable[[], T]) -> T:
    """Run the call on one of the reserved threads."""
    return await asyncio.get_running_loop().run_in_executor(_THREADS, call)


async def has_closed(request: Request) -> bool:
    """True if the caller has closed the connection. A server that was stopped or busy reads the request and the end of the
    connection one after the other; the event loop processes the end during the pauses. Do not use it for a request with a
    body, which it can consume."""
    for _ in range(TURNS):
        await asyncio.sleep(0)
    return await request.is_disconnected()


async def run_lookup(lookup: Callable[[], T], otherwise: Callable[[], T | None]) -> T:
    """Return the result of the lookup. If it takes longer than LOOKUP_S, return ``otherwise()`` instead, unless that is None."""
    result = asyncio.get_running_loop().run_in_executor(_LOOKUPS, lookup)
    await asyncio.wait({result}, timeout=LOOKUP_S)
    replacement = None if result.done() else otherwise()
    return await result if replacement is None else replacement
