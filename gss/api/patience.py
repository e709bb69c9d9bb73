"""HTTP for those who come straight to this server: who begins a request and does not go on with it gives the connection back.

uvicorn closes an idle connection after a few seconds but waits for the rest of a request for ever. A proxy in front does better: it
hands on whole requests only, and counts connections.
"""

from __future__ import annotations

from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

HEAD_WITHIN_S = 15.0
"""From the connection, or the answer before, to the end of a request's head."""
BODY_GOES_ON_WITHIN_S = 30.0
"""Between two pieces of a body, while somebody here waits for it."""
LOOK_EVERY_S = 5.0


class PatientHttp(H11Protocol):
    """uvicorn's own protocol with an end of its patience. What is being answered, a stream above all, lasts as long as it likes."""

    def connection_made(self, transport: Any) -> None:
        """Begin to watch."""
        super().connection_made(transport)
        self._since_s = self.loop.time()
        self._timer = self.loop.call_later(LOOK_EVERY_S, self._look)

    def connection_lost(self, exc: Exception | None) -> None:
        """Watch no longer."""
        self._timer.cancel()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """A head must end in time however often a byte of it comes; a body must go on."""
        super().data_received(data)
        if self._waits_for_body():
            self._since_s = self.loop.time()

    def on_response_complete(self) -> None:
        """The next request may begin."""
        self._since_s = self.loop.time()
        super().on_response_complete()

    def _is_answering(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _waits_for_body(self) -> bool:
        return self._is_answering() and self.conn.their_state is h11.SEND_BODY and not self.flow.read_paused

    def _look(self) -> None:
        now_s, for_body = self.loop.time(), self._waits_for_body()
        if self._is_answering() and not for_body:
            self._since_s = now_s
        if now_s - self._since_s >= (BODY_GOES_ON_WITHIN_S if for_body else HEAD_WITHIN_S):
            self.transport.abort()
        else:
            self._timer = self.loop.call_later(LOOK_EVERY_S, self._look)
