"""Services of recordings for the Rerun viewer."""

from __future__ import annotations

from dataclasses import dataclass

from gss.operations.frames.rerun_viewer import RerunViewer
from gss.operations.recordings.live import LiveRecordings
from gss.operations.recordings.scope import Scopes
from gss.operations.recordings.stored import Recordings
from gss.wiring.base import BaseServices
from gss.wiring.frames import Frames
from gss.wiring.line import Line
from gss.wiring.passes import Passes


@dataclass(frozen=True)
class RecordingsRoom:
    """Services of stored and live recordings, of the time ranges that they cover, and of the viewer's files."""

    stored: Recordings
    live: LiveRecordings
    scopes: Scopes
    viewer: RerunViewer


def open_recordings(base: BaseServices, line: Line, frames: Frames, passes: Passes) -> RecordingsRoom:
    """Create the recording services."""
    stored = Recordings(base.database, frames.frames, base.stars, passes.place.at, line.link.roles.quantities.status)
    return RecordingsRoom(
        stored,
        LiveRecordings(stored, base.database, base.bus, base.clock.now),
        Scopes(base.database, base.clock.now),
        RerunViewer(base.settings.data / "rerun-viewer"),
    )
