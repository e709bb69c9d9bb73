"""Header bar, counters and banks as responses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime
from typing import Any

from gss.api.schemas.link import (
    AlarmOut,
    AttitudeSampleOut,
    BankOut,
    CountersOut,
    DirectionCountersOut,
    DirectionOut,
    LinkOut,
    NextPassOut,
    ReportedAttitudeOut,
)
from gss.device.session_events import LinkCounters
from gss.operations.transfers.banks import BankView, days_left
from gss.operations.upkeep.status import Header
from gss.orbit.passes import NextPass

CONVERTED = ("tx", "rx", "banks", "alarms", "attitude", "attitudes", "next_pass")


def link(header: Header) -> LinkOut:
    """Return the header bar."""
    banks = [bank(view, header.utc) for view in header.banks]
    active = next((b for b in banks if b.active), None)
    values = {k: v for k, v in vars(header).items() if k not in CONVERTED}
    return LinkOut(
        **values,
        attitude=None if header.attitude is None else ReportedAttitudeOut.model_validate(header.attitude),
        attitudes=[AttitudeSampleOut.model_validate(sample) for sample in header.attitudes],
        next_pass=_next_pass(header.next_pass),
        tx=DirectionOut.model_validate(header.tx),
        rx=DirectionOut.model_validate(header.rx),
        banks=banks,
        active_bank=active,
        alarms=[AlarmOut.model_validate(a) for a in header.alarms],
    )


def _next_pass(next_pass: NextPass) -> NextPassOut:
    at = next_pass.at
    if at is None:
        return NextPassOut(station=None, rise=None, set=None, max_elevation_deg=None, problem=next_pass.problem)
    return NextPassOut(
        station=at.station, rise=at.rise, set=at.set, max_elevation_deg=math.degrees(at.max_elevation_rad), problem=""
    )


def counters(counted: LinkCounters, framing: str, housekeeping: Mapping[str, Any] | None) -> CountersOut:
    """Return the counters of both directions. The device's uplink counts come from its housekeeping."""
    reported = housekeeping or {}
    sent = DirectionCountersOut.model_validate(counted.sent)
    device_counts = {"device_good": reported.get("frames_good"), "device_bad": reported.get("frames_bad")}
    return CountersOut(
        framing=framing,
        sent=sent.model_copy(update=device_counts),
        received=DirectionCountersOut.model_validate(counted.received),
    )


def bank(view: BankView, now: datetime) -> BankOut:
    """Return a flash bank."""
    catalogue_row = view.catalogue
    return BankOut(
        bank=view.bank,
        state=view.state,
        active=view.active,
        catalogue_id=catalogue_row.id if catalogue_row else None,
        catalogue_name=catalogue_row.name if catalogue_row else None,
        stars=view.stars,
        pairs=view.pairs,
        sha256=view.sha256,
        valid_to=catalogue_row.valid_to if catalogue_row else None,
        days_left=days_left(catalogue_row.valid_to, now) if catalogue_row else None,
        validity_known=catalogue_row is not None and catalogue_row.validity_known,
    )
