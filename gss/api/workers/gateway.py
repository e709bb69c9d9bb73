"""Middleware and lifespan of an API worker: forward requests and receive the event stream of the link process."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from starlette.types import ASGIApp, Receive, Scope, Send

from gss.api.stream.broadcast import FIRST, Broadcaster
from gss.api.workers.local_routes import is_local

if TYPE_CHECKING:
    from gss.api.workers.link_client import LinkProcessClient

RECONNECT_S = 0.2


class Gateway:
    """Innermost middleware: requests that are not local go to the link process. The guard runs before it."""

    def __init__(self, app: ASGIApp, link: LinkProcessClient) -> None:
        self._app, self._link = app, link

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request locally or forward it."""
        if scope["type"] != "http" or is_local(scope["method"], scope["path"]):
            await self._app(scope, receive, send)
            return
        scope["gss.forwarded"] = True
        await self._link.forward(scope, receive, send)


@asynccontextmanager
async def relayed(link: LinkProcessClient, broadcaster: Broadcaster) -> AsyncIterator[None]:
    """Pass messages of the link process to ``broadcaster`` until the end of the block. The block starts after the first
    state was received. If the stream breaks, every listener is closed; clients reconnect and receive the missed
    events."""
    first = asyncio.Event()
    task = asyncio.create_task(_relay(link, broadcaster, first))
    await first.wait()
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def _relay(link: LinkProcessClient, broadcaster: Broadcaster, first: asyncio.Event) -> None:
    from httpx2 import TransportError  # imported here, because only workers need it

    while True:
        with contextlib.suppress(TransportError):
            async with contextlib.aclosing(link.messages()) as messages:
                async for message in messages:
                    broadcaster.spread((message,))
                    if message.topic == FIRST:
                        first.set()
        broadcaster.hang_up()
        await asyncio.sleep(RECONNECT_S)
