"""A minute of the required permanent load: fifty packets per second, ten subscribers and a browser."""

from __future__ import annotations

import asyncio
import json

import pytest

from tools.soak import loaded_server, soak

SECONDS = 60.0


@pytest.mark.browser
@pytest.mark.timeout(400)
def test_a_minute_of_fifty_packets_a_second_with_ten_listeners(tmp_path):
    """Nothing late, lost, dropped or growing, by the same limits as the hour and the day of ``make soak``.

    Less than a second of lag at the end and memory that stays are requirements of the product (lag is some tens of milliseconds on
    an idle machine); no speed is asserted. Packets are counted by their own numbers, messages by those of the stream.
    """
    with loaded_server(tmp_path / "data", rate=50.0, workers=0) as server:
        report = asyncio.run(soak(server, SECONDS, session=server.sign_in()))
    assert report.problems() == [], json.dumps(report.plain(), indent=1)
    assert sum(log.messages for log in report.logs) > 10 * SECONDS
