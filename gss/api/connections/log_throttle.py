"""Limit repeated log messages, so that clients cannot fill the log."""

from __future__ import annotations

import logging
from collections import OrderedDict

from gss.operations.clock import Monotonic, monotonic_s

LOGGERS = ("asyncio", "uvicorn.error", "gss.connections")
"""Loggers whose messages a client without an account can cause."""
PER_MINUTE = 5
WINDOW_S = 60.0
MAX_KINDS = 500


class LogThrottle(logging.Filter):
    """Log filter that passes at most ``PER_MINUTE`` messages of a kind per minute. The first message after that minute
    states how many similar messages were omitted. The kind is the logger plus the first line of the message before its
    arguments."""

    def __init__(self, monotonic_s: Monotonic) -> None:
        super().__init__()
        self._now_s = monotonic_s
        self._kinds: OrderedDict[tuple[str, str], tuple[float, int]] = OrderedDict()

    def filter(self, record: logging.LogRecord) -> bool:
        """True if the message is written to the log."""
        kind, now_s = (record.name, str(record.msg).partition("\n")[0]), self._now_s()
        begun_s, count = self._kinds.pop(kind, (now_s, 0))
        if now_s - begun_s >= WINDOW_S:
            omitted, begun_s, count = count - PER_MINUTE, now_s, 0
            if omitted > 0:
                record.msg = f"{record.msg} ({omitted} similar messages were omitted)"
        self._kinds[kind] = (begun_s, count + 1)
        while len(self._kinds) > MAX_KINDS:
            self._kinds.popitem(last=False)
        return count < PER_MINUTE


def throttle_logs() -> None:
    """Limit the loggers whose messages a client can cause, in this process."""
    throttle = LogThrottle(monotonic_s)
    for name in LOGGERS:
        logging.getLogger(name).addFilter(throttle)
