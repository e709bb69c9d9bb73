"""The data that a retention run removes, and whether the removal is unusual and needs confirmation."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from datetime import datetime, timedelta

from pydantic import AwareDatetime, Field

from gss.domain.errors import Conflict
from gss.operations.clock import iso_z
from gss.operations.requests import Request
from gss.store import upkeep as store

ARRIVED_FACTOR = 1.5
"""Multiple of the data that arrived since the last run up to which a removal is not unusual, even if it removes a large
share. A daily removal normally removes about as much data as arrived."""
ARRIVED_WITHIN = timedelta(days=2)
"""Maximum age of the last run for the rule of ``ARRIVED_FACTOR``. After a longer pause, most of the stored data would
have arrived since the last run."""
FEW = {"frames": 100, "frames_bytes": 100_000_000, "packets": 20_000, "events": 2_000}
"""Amounts up to which a removal is never unusual. Removals from small stores therefore need no confirmation."""
CONFIRM_WITHIN = timedelta(hours=1)
COUNTS = ("frames", "frames_bytes", "packets", "to_thin", "events")
LABELS = {
    "frames": "frames with pixels",
    "frames_bytes": "bytes of pixels",
    "packets": "telemetry packets",
    "events": "events",
}


@dataclass(frozen=True)
class Removal:
    """Amounts that a policy removes as of ``at``. ``frames_bytes``: size of the frames' pixels; ``to_thin``: packets to
    be thinned to one per minute, without packets already thinned; ``unusual``: why a user must confirm the removal, ""
    if no confirmation is needed."""

    at: datetime
    frames: int
    frames_bytes: int
    packets: int
    to_thin: int
    events: int
    unusual: str = ""


class ConfirmedRemoval(Request):
    """Removal that a person has confirmed: the time ``at`` of its preview, and its maximum amounts."""

    at: AwareDatetime = Field(strict=False)
    frames: int = Field(ge=0)
    frames_bytes: int = Field(ge=0)
    packets: int = Field(ge=0)
    to_thin: int = Field(ge=0)
    events: int = Field(ge=0)


def confirmation(removal: Removal) -> ConfirmedRemoval:
    """Return the confirmation of a preview, with its amounts as maximum."""
    return ConfirmedRemoval(at=removal.at, **{name: getattr(removal, name) for name in COUNTS})


def recent(last_run: datetime | None, at: datetime) -> datetime | None:
    """Return ``last_run`` if it was at most ``ARRIVED_WITHIN`` before ``at``, otherwise None."""
    return last_run if last_run is not None and at - last_run <= ARRIVED_WITHIN else None


def unusual(removal: Removal, amounts: store.Amounts, share: float) -> str:
    """Return the kinds of data whose removal exceeds both ``share`` of the stored data and ``ARRIVED_FACTOR`` times the
    data that arrived since a recent run, with their amounts; "" if there are none."""
    removed = asdict(removal) | {"packets": removal.packets + removal.to_thin}
    reasons = []
    for kind, small_amount in FEW.items():
        stored, arrived = amounts.stored[kind], amounts.arrived[kind]
        if removed[kind] > small_amount and removed[kind] > max(share * stored, ARRIVED_FACTOR * arrived):
            reasons.append(f"{removed[kind]} of {stored} {LABELS[kind]} ({100 * removed[kind] / max(1, stored):.0f} %)")
    return ", ".join(reasons)


def check_confirmed(removal: Removal, confirmed: ConfirmedRemoval | None, share: float) -> None:
    """Raise Conflict if the removal is unusual and not confirmed, or larger than confirmed."""
    if not removal.unusual:
        return
    hint = "check the preview (Admin, Storage, or gss retention), then confirm it"
    if confirmed is None:
        raise Conflict(
            "this removal is unusually large and needs confirmation",
            expected=f"at most {100 * share:g} % of a kind, or {ARRIVED_FACTOR:g} times the data that arrived since the last "
            f"removal, if it was at most {ARRIVED_WITHIN / timedelta(days=1):g} days ago",
            got=removal.unusual,
            hint=hint,
        )
    exceeded = [name for name in COUNTS if getattr(removal, name) > getattr(confirmed, name)]
    if exceeded:
        raise Conflict(
            "more data would be removed than confirmed",
            expected=", ".join(f"{name} up to {getattr(confirmed, name)}" for name in exceeded),
            got=", ".join(f"{name} {getattr(removal, name)}" for name in exceeded),
            hint=hint,
        )


def check_fresh(confirmed: ConfirmedRemoval, now: datetime) -> None:
    """Raise Conflict if the confirmed preview is too old or dated in the future."""
    if not now - CONFIRM_WITHIN <= confirmed.at <= now + timedelta(seconds=1):
        raise Conflict(
            "the confirmed preview is out of date",
            expected=f"a preview of the last hour, before {iso_z(now, 'seconds')}",
            got=iso_z(confirmed.at, "seconds"),
            hint="check the preview again",
        )
