"""Settings, commands and paths in deploy/ and in its documentation exist."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from gss.api.guard.bodies import MAX_BODY_BYTES
from gss.cli import full_parser
from gss.settings import Settings

KNOWN = {f"GSS_{name.upper()}" for name in Settings.model_fields}
OF_TESTS = {"GSS_TEST_FORBID_SKIPS", "GSS_SKY_PHOTOGRAPHS", "GSS_WRITE_GOLDEN", "GSS_FUZZ_EXAMPLES", "GSS_FUZZ_SEED"}
OF_THE_CLIENT = {"GSS_ADDRESS", "GSS_TOKEN"}
NEVER_ENDING = ("/api/stream", "/api/rerun/live")


def pages(root: Path) -> list[Path]:
    """Documents and files from which users copy settings."""
    return [*(root / "deploy").iterdir(), *(root / "docs").rglob("*.md"), *root.glob("*.md"), root / "Makefile"]


def test_every_named_setting_exists(root: Path) -> None:
    """Documents and deployment files name only GSS_* variables that the code reads.

    The changelog may name removed ones.
    """
    for page in pages(root):
        named = set(re.findall(r"\bGSS_[A-Z0-9_]*[A-Z0-9]\b", page.read_text())) - OF_TESTS - OF_THE_CLIENT
        assert page.name == "CHANGELOG.md" or named <= KNOWN, (page.name, named - KNOWN)


def test_the_environment_file_can_be_used_as_it_is(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each line of the environment file, including commented ones, has a valid value for its setting."""
    lines = re.findall(r"^#?(GSS_\w+)=(.*)$", (root / "deploy" / "gss.env").read_text(), re.MULTILINE)
    assert len(lines) > 10
    for name, value in lines:
        monkeypatch.setenv(name, value)
        assert str(getattr(Settings(), name.removeprefix("GSS_").lower())).lower() == value.lower()


def test_each_command_of_the_units_is_valid(root: Path) -> None:
    """The parser accepts each command line of the systemd units."""
    units = "".join(p.read_text() for p in (root / "deploy").glob("*.service"))
    lines = re.findall(r"^ExecStart=/opt/gss/bin/gss (.+)$", units, re.MULTILINE)
    assert len(lines) == 3
    for line in lines:
        assert full_parser().parse_args(line.split()).run


def test_the_service_is_confined(root: Path) -> None:
    """The service runs as a separate user without capabilities and writes only to its data folder.

    No watchdog is configured, because the server does not serve one.
    """
    unit = (root / "deploy" / "gss.service").read_text()
    for line in ("User=gss", "NoNewPrivileges=yes", "ProtectSystem=strict", "CapabilityBoundingSet=", "UMask=0077"):
        assert f"\n{line}\n" in unit
    assert "WatchdogSec" not in unit
    data = re.search(r"^GSS_DATA=(.*)$", (root / "deploy" / "gss.env").read_text(), re.MULTILINE)[1]
    assert data in re.search(r"^ReadWritePaths=(.*)$", unit, re.MULTILINE)[1].split()


def test_the_proxies_neither_buffer_nor_block(root: Path) -> None:
    """The proxies do not buffer endless responses.

    Their body limit is above the server's limit, so that the server can return an error message.
    """
    nginx, caddy = ((root / "deploy" / name).read_text() for name in ("nginx.conf", "Caddyfile"))
    for path in NEVER_ENDING:
        assert "proxy_buffering off;" in re.search(rf"location = {path} {{(.*?)}}", nginx, re.DOTALL)[1]
    assert "flush_interval -1" in caddy
    assert int(re.search(r"client_max_body_size (\d+)m;", nginx)[1]) << 20 > MAX_BODY_BYTES
    assert int(re.search(r"max_size (\d+)MB", caddy)[1]) * 1_000_000 > MAX_BODY_BYTES


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze here")
def test_systemd_reads_the_units(root: Path) -> None:
    """The only message of systemd-analyze is that the program is not installed."""
    units = [*(root / "deploy").glob("*.service"), *(root / "deploy").glob("*.timer")]
    report = subprocess.run(["systemd-analyze", "verify", *units], capture_output=True, text=True, timeout=60).stderr
    messages_about_gss = [line for line in report.splitlines() if "gss" in line and "is not executable" not in line]
    assert not messages_about_gss
