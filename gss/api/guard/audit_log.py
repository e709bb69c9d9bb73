"""Audit log: records every change, export and denied request. Failed and denied requests without sign-in are
sampled."""

from __future__ import annotations

import functools
import logging
from collections import OrderedDict
from collections.abc import Awaitable, Callable

import anyio.to_thread
from fastapi.routing import APIRoute
from starlette.types import Scope

from gss.api.deps import is_export, needs_of
from gss.api.guard.route_table import is_change, is_guarded
from gss.api.urgent import ABORT
from gss.operations.accounts.audit import AuditService, Result
from gss.operations.accounts.audit_intents import AuditIntents, Intent
from gss.operations.accounts.identity import CallerIdentity
from gss.operations.clock import Monotonic, Now, iso_z

DENIED = (401, 403, 429)
QUIET_S = 60.0
UNAUTHENTICATED = "nobody"
log = logging.getLogger("gss.api")


class AuditRecorder:
    """Writes one audit row for each change, export and denied request."""

    def __init__(self, audit: AuditService, intents: AuditIntents, now: Now, monotonic_s: Monotonic) -> None:
        self._audit, self._intents, self._now = audit, intents, now
        self._unauthenticated = UnauthenticatedSampler(monotonic_s)

    async def run(self, scope: Scope, route: object, work: Callable[[], Awaitable[None]]) -> None:
        """Run a request's route. The intent of a change is stored before the route starts. ABORT does not wait for the
        disk: its intent is stored while the route runs."""
        if not _is_recorded_change(scope, route):
            await work()
            return
        state, caller = scope["state"], scope["state"]["who"]
        intent = Intent(
            who=caller.name if caller else UNAUTHENTICATED,
            role=caller.role if caller else "",
            action=_action(route),
            target=_target(scope),
            address=state["address"],
            at=iso_z(self._now()),
        )
        store = functools.partial(self._intents.begin, intent)
        if scope["path"] != ABORT:
            state["intent"] = await anyio.to_thread.run_sync(store)
            await work()
            return
        async with anyio.create_task_group() as tasks:

            async def store_intent() -> None:
                state["intent"] = await anyio.to_thread.run_sync(store)

            tasks.start_soon(store_intent)
            await work()

    async def put(self, scope: Scope, status: int) -> None:
        """Write the audit row of a completed request, then remove its intent."""
        await self._put(scope, status)
        number = scope["state"].get("intent")
        if number is not None:
            await anyio.to_thread.run_sync(self._intents.end, number)

    async def _put(self, scope: Scope, status: int) -> None:
        """Write the audit row of a completed request. The link process writes the rows of forwarded requests."""
        route, state = scope.get("route"), scope["state"]
        denied = status in DENIED
        if scope.get("gss.forwarded") or not (denied or _is_recorded_change(scope, route) or is_export(route)):
            return
        caller: CallerIdentity | None = state["who"]
        action, detail = _action(route), state["detail"]
        if status == 429 or (caller is None and status >= 400):
            key = f"{caller.name if caller else state['address']} {action} {'denied' if denied else 'failed'}"
            skipped = None if caller is None and status == 429 else self._unauthenticated.seen(key)
            if skipped is None:
                return
            detail = f"{detail}; {skipped} similar entries were omitted" if skipped else detail
        name = state.get("named") or (caller.name if caller else UNAUTHENTICATED)
        result: Result = "denied" if denied else "done" if status < 400 else "failed"
        target = _target(scope)
        origin = {"role": caller.role if caller else "", "address": state["address"]}
        write = functools.partial(self._audit.record, name, action, target, result, detail, **origin)
        try:
            await anyio.to_thread.run_sync(write)
        except Exception:  # a failed audit write must not undo the change; it is logged instead
            log.exception("the audit log could not be written: %s %s %s by %s", action, target, result, name)


class UnauthenticatedSampler:
    """Limits the rows of denied and failed requests to one per minute and key, so that they cannot fill the disk. The
    row states how many requests were omitted. The key consists of the action and the client address. For a signed-in
    user over a rate limit, it consists of the action and the user name. Unauthenticated requests over a rate limit are
    not recorded."""

    MAX_KEYS = 2000

    def __init__(self, monotonic_s: Monotonic) -> None:
        self._now_s = monotonic_s
        self._recent: OrderedDict[str, tuple[float, int]] = OrderedDict()

    def seen(self, key: str) -> int | None:
        """Return the number of requests omitted since the last row of this key, or None if this request is omitted
        too."""
        at_s, skipped = self._recent.pop(key, (-QUIET_S, 0))
        is_due = self._now_s() - at_s >= QUIET_S
        self._recent[key] = (self._now_s(), 0) if is_due else (at_s, skipped + 1)
        while len(self._recent) > self.MAX_KEYS:
            self._recent.popitem(last=False)
        return skipped if is_due else None


def _is_recorded_change(scope: Scope, route: object) -> bool:
    return is_change(scope) and is_guarded(scope) and any(need.changes for need in needs_of(route))


def _target(scope: Scope) -> str:
    return f"{scope['method']} {scope['path'].removeprefix('/api')}"


def _action(route: object) -> str:
    """Return the names of router and function, for example alarms.acknowledge; "door" if no route was reached."""
    return f"{route.endpoint.__module__.rsplit('.', 1)[-1]}.{route.name}" if isinstance(route, APIRoute) else "door"
