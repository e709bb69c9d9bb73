"""pytest plug-in for tests with a real or simulated sensor behind a GSS server.

::

    def test_exposure_is_taken(unit, assert_telemetry):
        unit.send("TAKE_IMAGE", exposure_ms=200)
        assert_telemetry("housekeeping.exposure_ms", 200, within_s=5)

``pytest --gss http://localhost:8181`` sets the server; the token is in GSS_TOKEN. Without the option the tests are
skipped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from gss.client.client import Client
from gss.client.records import TelemetryValue

Expected = float | int | str | bool | Callable[[TelemetryValue], bool]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option ``--gss``."""
    parser.getgroup("gss").addoption(
        "--gss", metavar="ADDRESS", default="", help="address of the GSS server for tests with a sensor"
    )


@pytest.fixture(scope="session")
def gss_client(request: pytest.FixtureRequest) -> Iterator[Client]:
    """Client of the server that ``--gss`` names. Skips the test without the option."""
    address = request.config.getoption("--gss")
    if not address:
        pytest.skip("no GSS server: set one with --gss ADDRESS")
    with Client(address) as client:
        yield client


@pytest.fixture
def unit(gss_client: Client) -> Iterator[Client]:
    """Client of the server after its sensor has responded. The test has command authority."""
    gss_client.wait_connected()
    with gss_client.authority():
        yield gss_client


@pytest.fixture
def wait_for(unit: Client) -> Callable[..., TelemetryValue]:
    """``wait_for(field, expected, within_s=10)``: wait for a value of ``packet.field``. Raises TimedOut if the value is
    not received. ``expected``: the value, or a function that returns True for an accepted TelemetryValue."""

    def wait(field: str, expected: Expected, within_s: float = 10.0) -> TelemetryValue:
        return unit.wait_telemetry(field, _accepts(expected), within_s)

    return wait


@pytest.fixture
def assert_telemetry(unit: Client) -> Callable[..., None]:
    """``assert_telemetry(field, expected, within_s=10, tolerance=0)``: fail the test with the last value if the
    expected value is not received."""

    def check(field: str, expected: Expected, within_s: float = 10.0, tolerance: float = 0.0) -> None:
        from gss.client.errors import TimedOut

        try:
            unit.wait_telemetry(field, _accepts(expected, tolerance), within_s)
        except TimedOut as error:
            pytest.fail(f"{error} Expected {'an accepted value' if callable(expected) else expected!r}.", pytrace=False)

    return check


def _accepts(expected: Expected, tolerance: float = 0.0) -> Callable[[TelemetryValue], bool]:
    if callable(expected):
        return expected
    if isinstance(expected, str | bool):
        return lambda value: value.value == expected or value.formatted == expected
    return lambda value: isinstance(value.value, float | int) and abs(value.value - expected) <= tolerance
