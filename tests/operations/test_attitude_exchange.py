"""Attitude messages of other systems are read with the limits of untrusted files."""

from __future__ import annotations

import numpy as np
import pytest

from gss.domain.errors import TooCostly
from gss.operations.frames.attitude_exchange import AttitudeExchange
from gss.operations.parsing.parse_processes import ParseProcesses
from gss.operations.parsing.parse_worker import ParseLimits
from gss.orbit.attitude import AttitudeHistory
from gss.orbit.write_attitude import aem_of


def test_a_message_is_read_in_a_child_process_with_limits(database, clock) -> None:
    """A message that exceeds the limits of the child process is rejected. 20 MB of very short lines would need more than a
    gigabyte of memory."""
    times_s = clock().timestamp() + np.arange(20.0)
    history = AttitudeHistory("A", "SC_BODY_1", times_s, np.tile([0, 0, 0, 1.0], (20, 1)), np.full((20, 3), np.nan))
    data = "".join(aem_of(history, clock())).encode()
    with ParseProcesses(ParseLimits(result_bytes=100)) as parsing:
        exchange = AttitudeExchange(database, parsing, lambda: "unit", clock)
        with pytest.raises(TooCostly, match="the message is too expensive to read"):
            exchange.compare(data, "ground")
