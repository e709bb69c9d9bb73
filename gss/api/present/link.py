"""Header bar, counters and banks as responses."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from gss.api.schemas.link import (
    AlarmOut,
    BankOut,
    CountersOut,
    DirectionCountersOut,
    DirectionOut,
    LinkOut,
    ReportedAttitudeOut,
)
from gss.device.session_events import LinkCounters
from gss.operations.transfers.banks import BankView, days_left
from gss.operations.upkeep.status import Header


def link(header: Header) -> LinkOut:
    """Return the header bar."""
    banks = [bank(view, header.utc) for view in header.banks]
    active = next((b for b in banks if b.active), None)
    values = {k: v for k, v in vars(header).items() if k not in ("tx", "rx", "banks", "alarms", "attitude")}
    return LinkOut(
        **values,
        attitude=None if header.attitude is None else ReportedAttitudeOut.model_validate(header.attitude),
        tx=DirectionOut.model_validate(header.tx),
        rx=DirectionOut.model_validate(header.rx),
        banks=banks,
        active_bank=active,
        alarms=[AlarmOut.model_validate(a) for a in header.alarms],
    )


def counters(counted: LinkCounters, framing: str, housekeeping: Mapping[str, Any] | None) -> CountersOut:
    """Return the counters of both directions. The device's own counts of the uplink come from its housekeeping."""
    reported = housekeeping or {}
    sent = DirectionCountersOut.model_validate(counted.sent)
    far = {"device_good": reported.get("frames_good"), "device_bad": reported.get("frames_bad")}
    return CountersOut(
        framing=framing,
        sent=sent.model_copy(update=far),
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
    )
