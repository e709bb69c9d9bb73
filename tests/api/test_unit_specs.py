"""Units as the command line and GSS_UNITS name them: what is accepted, what is refused, and the settings of their
processes."""

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
    """Name, instrument and address of each; simulated units may repeat their address."""
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
    """The server does not start with a unit that it would not serve."""
    with pytest.raises(BadInput, match=words):
        parse_units(text, registry)


def test_an_instrument_that_is_not_installed_is_refused(registry: Registry) -> None:
    """The message lists the installed ones."""
    with pytest.raises((NotFound, BadInput)) as raised:
        parse_units("FM1=kepler@simulator", registry)
    assert "cubestar" in str(raised.value)


@pytest.mark.parametrize("given", [{"device": "/dev/tty1"}, {"simulator": "aim"}, {"workers": 2}])
def test_options_for_a_single_unit_do_not_go_with_several(given: dict[str, object]) -> None:
    """A separate line and API workers are options of a server with one unit."""
    with pytest.raises(GssError, match="cannot be used with --unit"):
        check_combination(Settings.model_validate(given))
    check_combination(Settings())


def test_a_units_process_has_its_own_data_and_the_servers_accounts(tmp_path: Path) -> None:
    """No folder, database or object prefix is shared between units; accounts and instrument packages are."""
    server = Settings(
        data=tmp_path, blobs="s3://bucket/gss/", backups="/backups", audit_anchor="/anchor", simulator_seed=7
    )
    made = [unit_settings(server, UnitSpec(name, "cubestar", "simulator"), k) for k, name in enumerate(("A", "B"))]
    for own in ("data", "database_url", "blobs_url", "backups_folder", "audit_anchor_file", "simulator_seed"):
        assert len({str(getattr(s, own)) for s in (server, *made)}) == (2 if own == "simulator_seed" else 3), own
    for shared in ("accounts", "instruments_folder"):
        assert len({str(getattr(s, shared)) for s in made}) == 1
    assert made[0].accounts == server.database_url
    assert made[0].data == tmp_path / "units" / "A"
    assert made[0].blobs == "s3://bucket/gss/units/A"
    assert made[0].unit_instrument == "cubestar"
    line = unit_settings(server, UnitSpec("C", "nos3", "socket://127.0.0.1:5060"), 2)
    assert (line.device, line.simulator, line.unit_instrument) == ("socket://127.0.0.1:5060", "", "nos3")


def test_units_on_one_body_are_the_heads_with_their_names(tmp_path: Path) -> None:
    """With --body among the simulator's options each unit names its head; other options are the same for all."""
    for options, expected in (
        ("--body sat.yaml --sky real", "--body sat.yaml --sky real --head A"),
        ("--sky real",) * 2,
    ):
        server = Settings(data=tmp_path, simulator_options=options)
        unit = unit_settings(server, UnitSpec("A", "cubestar", "simulator"), 0)
        assert unit.simulator_options == expected
