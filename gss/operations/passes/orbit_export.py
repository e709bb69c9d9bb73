"""Export of the active orbit as CCSDS files: OMM for a TLE, OEM for any orbit."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime, timedelta

from gss.domain.errors import Conflict
from gss.operations.passes.spacecraft import CurrentOrbit
from gss.orbit.oem import oem_of
from gss.orbit.omm import omm_of_tle

MAX_OEM_DAYS = 5.0
STEP_S = 60.0


def omm_fields(current: CurrentOrbit) -> dict[str, object]:
    """Return the active mean elements as the fields of an OMM. Raises Conflict if the active orbit is an ephemeris."""
    if current.row.kind != "tle":
        raise Conflict("the active orbit has no mean elements", got=current.row.source_format, hint="Export an OEM.")
    return omm_of_tle(current.row.spacecraft, current.row.text)


def oem_file(current: CurrentOrbit, start: datetime, days: float) -> Iterator[str]:
    """Yield the lines of an OEM that begins at ``start`` and covers ``days``, limited to the validity of the orbit. Raises
    BadInput if the validity has ended."""
    first = max(start, current.orbit.start)
    return oem_of(current.row.spacecraft, current.orbit, first, first + timedelta(days=days), STEP_S, start)
