"""Creates recordings from stored frames, telemetry, commands and events, in order of time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from datetime import datetime, timedelta
from functools import partial
from heapq import merge

from gss.domain.stars import StarTable
from gss.instruments.telemetry_roles import Status
from gss.operations.frames.frames import FrameService
from gss.operations.recordings.blueprints import Use
from gss.operations.recordings.lanes import LANES
from gss.operations.recordings.recorder import PlaceAt, Recorder, pixels_of
from gss.operations.recordings.scope import Scope
from gss.store import commands, events, frames, telemetry
from gss.store.engine import Database

MAX_PICTURES = 60
"""Maximum number of pictures. With more frames, only every n-th frame has a picture and marks of its stars, because a
viewer loads the complete recording. All frames have their attitude and figures."""
MAX_LINES = 5000
MAX_PACKETS = 3600
MAX_SPAN = timedelta(days=2)
"""Longest time span for which telemetry and log are included. A longer recording contains only the frames, unless it is
a recording of a contact."""
PLOTTED = (
    "sensor_temperature",
    "processor_temperature",
    "imager_current",
    "supply_voltage",
    "background_dn",
    "match_confidence",
    "stars_matched",
    "centroids_found",
    "attitude_age_s",
    "sigma_cross_arcsec",
    "rate_deg_s",
)
RECORDED = (*PLOTTED, *LANES)
"""Standard quantities of the sensor's status in a recording."""
Step = tuple[datetime, int, Callable[[], None]]


def recorded_fields(status: Status) -> dict[str, str]:
    """Return the field names of the status packet by recorded quantity, without those that the sensor does not report."""
    return {quantity: name for quantity, name in status.fields().items() if quantity in RECORDED}


class Recordings:
    """Creates recordings of stored data."""

    def __init__(
        self, database: Database, frame_service: FrameService, stars: StarTable, place_at: PlaceAt, status: Status
    ) -> None:
        self._database, self._frames, self._stars, self._place_at = database, frame_service, stars, place_at
        self.status = status

    def recorder(self, name: str, use: Use) -> Recorder:
        """Return an empty recorder with layout and sky."""
        return Recorder(name, use, self._stars, self._place_at)

    def write(self, scope: Scope) -> bytes:
        """Return the .rrd file of a scope."""
        recorder = self.recorder(scope.name, scope.use)
        for _, _, step in merge(self._pictures(recorder, scope), self._around(recorder, scope), key=lambda s: s[:2]):
            step()
        return recorder.take()

    def _pictures(self, recorder: Recorder, scope: Scope) -> Iterator[Step]:
        with self._database.unit_of_work() as session:
            times = sorted((frames.get(session, i).taken, i) for i in scope.frame_ids)
        picture_interval = -(-len(times) // MAX_PICTURES)
        for k, (moment, frame_id) in enumerate(times):
            shown = k % picture_interval == 0
            yield moment, 0, partial(self.frame, recorder, frame_id, shown, marks=shown)

    def frame(self, recorder: Recorder, frame_id: int, picture: bool, *, marks: bool = True) -> None:
        """Add one stored frame with its solutions."""
        detail = self._frames.detail(frame_id, overlays=marks)
        recorder.frame(detail, pixels_of(detail.frame, self._frames.pixels) if picture else None, marks)

    def _around(self, recorder: Recorder, scope: Scope) -> Iterator[Step]:
        if scope.end - scope.start > MAX_SPAN and scope.use is not Use.CONTACT:
            return
        with self._database.unit_of_work() as session:
            event_rows = events.between(session, scope.start, scope.end, MAX_LINES)
            command_rows = commands.page(session, commands.Filter(start=scope.start, end=scope.end), MAX_LINES)
        steps: list[Step] = [(e.at, 2, partial(recorder.event, e)) for e in event_rows]
        steps += [(c.finished or c.created, 1, partial(recorder.command, c)) for c in command_rows]
        fields = recorded_fields(self.status)
        names = tuple(fields.values())
        rows = list(telemetry.rows(self._database, self.status.packet, names, scope.start, scope.end)) if names else []
        for row in rows[:: -(-len(rows) // MAX_PACKETS) or 1]:
            values = dict(zip(fields, row.values, strict=True))
            steps.append((row.received, 3, partial(recorder.telemetry, row.received, values)))
        yield from sorted(steps, key=lambda s: s[:2])
