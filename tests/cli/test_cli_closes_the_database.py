"""A command closes the database of the data folder."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from gss.settings import Settings
from gss.wiring.build import build


def test_a_command_leaves_no_log_of_sqlite(tmp_path: Path) -> None:
    """After the command, the file of the database is complete: its log is gone, so that a copy of the file is enough."""
    folder = tmp_path / "data"
    services = build(Settings(data=folder))
    services.start()
    services.stop()
    before = sorted(path.name for path in folder.glob("gss.db*"))
    command = [sys.executable, "-m", "gss", "export", "solutions", "--data", str(folder), "--out"]
    ran = subprocess.run(
        [*command, str(tmp_path / "solutions.csv")], capture_output=True, text=True, timeout=60, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert sorted(path.name for path in folder.glob("gss.db*")) == before == ["gss.db"]
