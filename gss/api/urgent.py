"""Threads for ABORT alone: those of all other requests may be busy, or be asked for by hundreds."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

ABORT = "/api/commands/abort"
T = TypeVar("T")
_THREADS = ThreadPoolExecutor(max_workers=4, thread_name_prefix="abort")


async def at_once(call: Callable[[], T]) -> T:
    """Run it on one of them."""
    return await asyncio.get_running_loop().run_in_executor(_THREADS, call)
