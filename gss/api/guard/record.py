"""Audit log: records every change, export and denied request; failed and denied requests without sign-in are sampled."""

from __future__ import annotations

import functools
import logging
from collections import OrderedDict

import anyio.to_thread
from fastapi.routing import APIRoute
from starlette.types import Scope

from gss.api.deps import is_export, needs_of
from gss.api.guard.door import is_change, is_guarded
from gss.operations.accounts.audit import AuditService, Result
from gss.operations.accounts.identity import Who
from gss.operations.clock import Monotonic

DENIED = (401, 403, 429)
QUIET_S = 60.0
log = logging.getLogger("gss.api")


class Record:
    """Writes one audit row for each change, export and denied request."""

    def __init__(self, audit: AuditService, monotonic_s: Monotonic) -> None:
        self._audit, self._unauthenticated = audit, UnauthenticatedSampler(monotonic_s)

    async def put(self, scope: Scope, status: int) -> None:
        """Write the row of an answered request. For forwarded requests the link process writes it."""
        route, state = scope.get("route"), scope["state"]
        denied = status in DENIED
        if scope.get("gss.forwarded") or not (denied or _is_changed(scope, route) or is_export(route)):
            return
        who: Who | None = state["who"]
        action, detail = _action(route), state["detail"]
        if status == 429 or (who is None and status >= 400):
            key = f"{who.name if who else state['address']} {action} {'denied' if denied else 'failed'}"
            skipped = None if who is None and status == 429 else self._unauthenticated.seen(key)
            if skipped is None:
                return
            detail = f"{detail}; {skipped} more like this were not written" if skipped else detail
        name = state.get("named") or (who.name if who else "nobody")
        result: Result = "denied" if denied else "done" if status < 400 else "failed"
        target = f"{scope['method']} {scope['path'].removeprefix('/api')}"
        place = {"role": who.role if who else "", "address": state["address"]}
        write = functools.partial(self._audit.record, name, action, target, result, detail, **place)
        try:
            await anyio.to_thread.run_sync(write)
        except Exception:  # a failed audit write must not undo the change; it is logged instead
            log.exception("the audit record could not be written: %s %s %s by %s", action, target, result, name)


class UnauthenticatedSampler:
    """Samples denied and failed requests so that they cannot fill the disk: one row a minute for each key, with a count of the
    others. The key is the action with the address or, for a signed-in user over a rate limit, the name. An unauthenticated request
    over a rate limit is not recorded."""

    MOST = 2000

    def __init__(self, monotonic_s: Monotonic) -> None:
        self._now_s = monotonic_s
        self._seen: OrderedDict[str, tuple[float, int]] = OrderedDict()

    def seen(self, key: str) -> int | None:
        """Return how many were left out since the last row of this key, or None if this one is left out."""
        at_s, skipped = self._seen.pop(key, (-QUIET_S, 0))
        fresh = self._now_s() - at_s >= QUIET_S
        self._seen[key] = (self._now_s(), 0) if fresh else (at_s, skipped + 1)
        while len(self._seen) > self.MOST:
            self._seen.popitem(last=False)
        return skipped if fresh else None


def _is_changed(scope: Scope, route: object) -> bool:
    return is_change(scope) and is_guarded(scope) and any(need.changes for need in needs_of(route))


def _action(route: object) -> str:
    """Return router and function, as alarms.acknowledge; "door" if the guard itself answered."""
    return f"{route.endpoint.__module__.rsplit('.', 1)[-1]}.{route.name}" if isinstance(route, APIRoute) else "door"
