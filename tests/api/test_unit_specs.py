"""Specifications of units on the command line and in GSS_UNITS, and the settings of their processes."""

from __future__ import annotations

from pathlib import Path

import pytest

from gss.api.units.unit_spec import UnitSpec, check_combination, parse_units, unit_settings
from gss.domain.errors import BadInput, GssError, NotFound
from gss.instruments.registry import Registry
from gss.settings import Settings


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    return Registry(tmp_path / "instruments")


def test_a_list_of_units_is_read_in_its_order(registry: Registry) -> None:
    """Each unit has a name, an instrument and an address. Several units may be simulated."""
    text = "FM1=cubestar@/dev/ttyUSB0, EM-2=nos3@udp://10.0.0.2:5000,S1=sagitta@simulator,S2=sagitta@simulator"
    units = parse_units(text, registry)
    assert units[:2] == (UnitSpec("FM1", "cubestar", "/dev/ttyUSB0"), UnitSpec("EM-2", "nos3", "udp://10.0.0.2:5000"))
    assert [u.simulated for u in units] == [False, False, True, True]
    assert parse_units("", registry) == ()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("FM1", "a unit needs a name, an instrument and an address"),
        ("FM1=cubestar", "a unit needs a name, an instrument and an address"),
        ("FM1=@simulator", "a unit needs a name, an instrument and an address"),
        ("=cubestar@simulator", "invalid unit name"),
        ("../x=cubestar@simulator", "invalid unit name"),
        (f"{'a' * 25}=cubestar@simulator", "invalid unit name"),
        ("FM1=cubestar@ftp://host:1", "invalid line address"),
        ("FM1=cubestar@simulator,fm1=nos3@simulator", "two units have the same name"),
        ("A=cubestar@/dev/tty1,B=nos3@/dev/tty1", "two units have the same address"),
        (",".join(f"U{k}=nos3@simulator" for k in range(33)), "too many units"),
    ],
)
def test_a_wrong_unit_is_named_with_its_reason(registry: Registry, text: str, words: str) -> None:
    """An invalid unit is rejected with the reason, so that the server does not start with it."""
    with pytest.raises(BadInput, match=words):
        parse_units(text, registry)


def test_an_instrument_that_is_not_installed_is_refused(registry: Registry) -> None:
    """An instrument that is not installed is rejected with a list of the installed instruments."""
    with pytest.raises((NotFound, BadInput)) as raised:
        parse_units("FM1=kepler@simulator", registry)
    assert "cubestar" in str(raised.value)


def test_an_invalid_package_does_not_stop_the_other_units(tmp_path: Path) -> None:
    """A unit whose package is installed but invalid is accepted: its own process reports the reason."""
    (tmp_path / "mine").mkdir()
    units = parse_units("FM1=nos3@simulator,EM=mine@simulator", Registry(tmp_path))
    assert [unit.instrument for unit in units] == ["nos3", "mine"]


def test_two_names_of_one_port_are_one_address(registry: Registry, tmp_path: Path) -> None:
    """A serial port and a link to it are the same address."""
    (tmp_path / "by-id").symlink_to("/dev/ttyUSB0")
    with pytest.raises(BadInput, match="two units have the same address"):
        parse_units(f"A=nos3@/dev/ttyUSB0,B=nos3@{tmp_path / 'by-id'}", registry)


@pytest.mark.parametrize("options", [{"device": "/dev/tty1"}, {"simulator": "aim"}, {"workers": 2}])
def test_options_for_a_single_unit_cannot_be_used_with_several(options: dict[str, object]) -> None:
    """A line, a simulator and API workers are options of a server with one unit."""
    with pytest.raises(GssError, match="cannot be used with --unit"):
        check_combination(Settings.model_validate(options))
    check_combination(Settings())


def test_a_units_process_has_its_own_data_and_the_servers_accounts(tmp_path: Path) -> None:
    """Units have separate folders, databases and object prefixes, and share accounts and instrument packages."""
    server = Settings(
        data=tmp_path, blobs="s3://bucket/gss/", backups="/backups", audit_anchor="/anchor", simulator_seed=7
    )
    units = [unit_settings(server, UnitSpec(name, "cubestar", "simulator"), k) for k, name in enumerate(("A", "B"))]
    for separate in ("data", "database_url", "blobs_url", "backups_folder", "audit_anchor_file", "simulator_seed"):
        assert len({str(getattr(s, separate)) for s in (server, *units)}) == (
            2 if separate == "simulator_seed" else 3
        ), separate
    for shared in ("accounts", "instruments_folder"):
        assert len({str(getattr(s, shared)) for s in units}) == 1
    assert units[0].accounts == server.database_url
    assert units[0].data == tmp_path / "units" / "A"
    assert units[0].blobs == "s3://bucket/gss/units/A"
    assert units[0].unit_instrument == "cubestar"
    line = unit_settings(server, UnitSpec("C", "nos3", "socket://127.0.0.1:5060"), 2)
    assert (line.device, line.simulator, line.unit_instrument) == ("socket://127.0.0.1:5060", "", "nos3")


def test_units_on_one_body_are_the_heads_with_their_names(tmp_path: Path) -> None:
    """With the simulator option --body each unit selects its head. Other options are the same for all units."""
    for options, expected in (
        ("--body sat.yaml --sky real", "--body sat.yaml --sky real --head A"),
        ("--sky real",) * 2,
    ):
        server = Settings(data=tmp_path, simulator_options=options)
        unit = unit_settings(server, UnitSpec("A", "cubestar", "simulator"), 0)
        assert unit.simulator_options == expected
