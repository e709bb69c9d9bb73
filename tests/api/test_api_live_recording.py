"""Connections of live recordings."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest
from starlette.requests import ClientDisconnect

from gss.api.routers.rerun import Pieces


def test_a_client_that_left_before_the_first_block_frees_its_place() -> None:
    """The server closes the recording although the client disconnected before it received data."""
    closed: list[bool] = []

    async def pieces() -> AsyncIterator[bytes]:
        yield b"never taken"

    async def gone(_message: Any) -> None:
        raise OSError("gone")

    async def silent() -> Any:
        await asyncio.Event().wait()

    answer = Pieces(pieces(), lambda: closed.append(True))
    with pytest.raises(ClientDisconnect):
        asyncio.run(answer({"type": "http", "asgi": {"spec_version": "2.4"}}, silent, gone))
    assert closed == [True]


def test_a_proxy_in_front_of_several_units_does_not_buffer_it_either() -> None:
    """The response forbids nginx to buffer it, because a path below /units is not among the paths of its example file."""
    assert Pieces(_nothing(), lambda: None).headers["x-accel-buffering"] == "no"


async def _nothing() -> AsyncIterator[bytes]:
    return
    yield b""
