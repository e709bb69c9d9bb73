"""``gss passes``: orbit, stations, passes and calendar on the terminal, with the data of the server."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import pytest

from gss.cli import main
from gss.operations.accounts.audit import AuditFilter
from gss.orbit.oem import oem_of
from gss.orbit.read_orbit import read_orbit
from gss.settings import Settings
from gss.wiring.build import build

TLE = """ISS (ZARYA)
1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991
2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482
"""


def ephemeris() -> str:
    """Return an OEM of the orbit with its times shifted to begin now; the positions are not physically valid then."""
    start, now = datetime(2019, 12, 10, tzinfo=UTC), datetime.now(UTC)
    lines = oem_of("ZA-1", read_orbit(TLE).orbit, start, start.replace(day=12), 60.0, start)
    texts = []
    for line in lines:
        head, _, values = line.partition(" ")
        if head.startswith("2019-12-1"):
            moved = now + (datetime.fromisoformat(head).replace(tzinfo=UTC) - start)
            texts.append(f"{moved:%Y-%m-%dT%H:%M:%S.%f} {values}")
        else:
            texts.append(line)
    return "".join(texts)


def test_orbit_station_and_passes_without_a_browser(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Orbit, station, list of passes and calendar work in a new folder. The audit log records every change."""
    data = ["--data", str(tmp_path)]
    assert main(["passes", "list", *data]) == 1
    assert "No orbit was imported" in capsys.readouterr().err
    (tmp_path / "orbit.oem").write_text(ephemeris())
    assert main(["passes", "orbit", str(tmp_path / "orbit.oem"), "--source", "flight dynamics", *data]) == 0
    assert "OEM KVN" in capsys.readouterr().out
    (tmp_path / "mask.txt").write_text("# hills\n90, 12\n0 4\n")
    station = ["passes", "add-station", "Stellenbosch", "--latitude-deg", "-33.9275", "--longitude-deg", "18.865"]
    assert main([*station, "--mask", str(tmp_path / "mask.txt"), *data]) == 0
    assert main([*station, *data]) == 2
    assert main(["passes", "stations", *data]) == 0
    assert "mask of 2 points" in capsys.readouterr().out
    assert main(["passes", "list", "--days", "1.5", "--json", *data]) == 0
    table = json.loads(capsys.readouterr().out)
    assert len(table["passes"]) >= 4
    assert main(["passes", "list", "--days", "1.5", "--station", "Stellenbosch", *data]) == 0
    assert len(capsys.readouterr().out.splitlines()) == len(table["passes"]) + 1
    assert main(["passes", "calendar", "--days", "1.5", "--out", str(tmp_path / "passes.ics"), *data]) == 0
    assert (tmp_path / "passes.ics").read_text().count("BEGIN:VEVENT") == len(table["passes"])
    assert main(["passes", "delete-station", "Stellenbosch", *data]) == 0
    services = build(Settings(data=tmp_path))
    actions = [row.action for row in services.accounts.audit.page(AuditFilter(), 10, None)]
    assert services.passes.stations.list_all() == []
    assert actions == ["shell.station_delete", "shell.station_add", "shell.orbit_import"]


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["orbit", "wrong.tle"], "wrong checksum"),
        (["orbit", "old.tle"], "too old"),
        (["list", "--days", "0"], "Days are out of range"),
        (["list", "--station", "nowhere"], "No such ground station"),
        (["delete-station", "nowhere"], "No such ground station"),
        (["add-station", "x", "--latitude-deg", "91", "--longitude-deg", "0"], "latitude_deg"),
        (
            ["add-station", "x", "--latitude-deg", "1", "--longitude-deg", "0", "--mask", "old.tle"],
            "Line 1 of the mask",
        ),
    ],
)
def test_bad_input_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], reason: str
) -> None:
    """Invalid input gives exit code 2 and the reason."""
    (tmp_path / "old.tle").write_text(TLE)
    (tmp_path / "wrong.tle").write_text(TLE.replace("9991", "9992"))
    monkeypatch.chdir(tmp_path)
    assert main(["passes", *words, "--data", str(tmp_path)]) == 2
    assert reason.lower() in capsys.readouterr().err.lower()
