"""Services of the line: the link, which owns the port, and the events that it publishes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gss.device.driver import open_driver
from gss.device.link_keys import packet_signer
from gss.operations.clock import monotonic_s, utc_us
from gss.operations.line.capture_packing import CapturePacking
from gss.operations.line.dispatcher import LineEventQueue
from gss.operations.line.line_capture import CaptureSync
from gss.operations.line.link import LinkService, OpenLine
from gss.operations.line.raw_capture import Retention
from gss.wiring.base import BaseServices


@dataclass(frozen=True)
class Line:
    """The link, the queue of its events, and the flushing and compression of its capture files."""

    link: LinkService
    events: LineEventQueue
    capture_sync: CaptureSync
    capture_packing: CapturePacking


def open_line_room(base: BaseServices, open_line: OpenLine | None) -> Line:
    """Create the line services. ``open_line``: replaces the function that opens real ports; None for real ports."""
    settings, events = base.settings, LineEventQueue(base.clock.now, base.clock.monotonic_s)
    signer = packet_signer(Path(settings.link_keys), utc_us) if settings.link_keys else None
    link = LinkService(
        base.dictionary,
        base.unit.roles,
        base.database,
        base.bus,
        base.captures,
        base.clock.now,
        base.clock.monotonic_s,
        events,
        open_driver(base.unit, settings.framing, signer),
        Retention(settings.capture_file_mb << 20, settings.capture_keep_mb << 20),
        base.unit.link,
        base.version_of,
        settings.device if settings.simulator else "",
        open_line,
    )
    return Line(link, events, CaptureSync(link.capture, monotonic_s), CapturePacking(link.capture, monotonic_s))
