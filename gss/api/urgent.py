"""Threads reserved for ABORT, because other requests can fill the shared thread pool."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

ABORT = "/api/commands/abort"
T = TypeVar("T")
_THREADS = ThreadPoolExecutor(max_workers=4, thread_name_prefix="abort")


async def run_urgent(call: Callable[[], T]) -> T:
    """Run the call on one of the reserved threads."""
    return await asyncio.get_running_loop().run_in_executor(_THREADS, call)
