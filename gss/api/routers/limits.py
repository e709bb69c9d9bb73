"""Telemetry limits: the active limit set, and operators' overrides."""

from __future__ import annotations

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import App, AuditNote, User, need
from gss.api.schemas.telemetry import LimitIn, LimitOut, LimitSetIn, LimitsOut
from gss.domain.limits import Limits, Range
from gss.operations.telemetry.limit_book import Rule, words

router = api_router("telemetry", "/telemetry/limits")


@router.get("")
def read_limits(app: App) -> LimitsOut:
    """Active limits of all fields."""
    return present.telemetry.limits(app.telemetry.telemetry.limits)


@router.put("/set", dependencies=[need("limits")])
def choose_set(app: App, user: User, body: LimitSetIn, audit_note: AuditNote) -> LimitsOut:
    """Activate another limit set."""
    audit_note(f"from {app.telemetry.telemetry.limits.chosen} to {body.name}", body.note)
    app.telemetry.telemetry.limits.choose(body.name, user=user, note=body.note)
    return present.telemetry.limits(app.telemetry.telemetry.limits)


@router.put("/{key}", dependencies=[need("limits")])
def override(app: App, user: User, key: str, body: LimitIn, audit_note: AuditNote) -> LimitOut:
    """Override the limits of a field ``packet.name``. The override applies in every limit set until it is deleted."""
    limits = Limits(_range(body.watch), _range(body.warning), _range(body.critical))
    packet, field = app.telemetry.telemetry.limits.find(key)
    rule = Rule(limits, field.persistence if body.persistence is None else body.persistence)
    audit_note(f"{key} from {words(app.telemetry.telemetry.limits.rule(packet, field))} to {words(rule)}", body.note)
    app.telemetry.telemetry.limits.override(key, limits, body.persistence, user=user, note=body.note)
    return present.telemetry.limit(app.telemetry.telemetry.limits, *app.telemetry.telemetry.limits.find(key))


def _range(pair: list[float | int | None]) -> Range:
    low, high = pair
    return low, high


@router.delete("/{key}", dependencies=[need("limits")])
def restore(app: App, user: User, key: str, audit_note: AuditNote) -> LimitOut:
    """Delete the override of a field's limits."""
    packet, field = app.telemetry.telemetry.limits.find(key)
    rules = [app.telemetry.telemetry.limits.rule(packet, field), app.telemetry.telemetry.limits.given(field)]
    audit_note(f"{key} from {words(rules[0])} to {words(rules[1])}")
    app.telemetry.telemetry.limits.restore(key, user=user)
    return present.telemetry.limit(app.telemetry.telemetry.limits, *app.telemetry.telemetry.limits.find(key))
