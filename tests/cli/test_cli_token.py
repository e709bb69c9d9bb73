"""``gss token`` on the command line."""

from __future__ import annotations

from pathlib import Path

import pytest

from gss.cli import main
from gss.settings import Settings
from gss.store.migration import migrate


def test_a_restriction_without_permissions_is_rejected(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An empty list of permissions would give the token all permissions of its role."""
    migrate(Settings(data=tmp_path).database_url)
    for only in (",", ""):
        assert main(["token", "add", "night", "--role", "operator", "--only", only, "--data", str(tmp_path)]) == 2
        assert "--only has no permission" in capsys.readouterr().err
    assert main(["token", "list", "--data", str(tmp_path)]) == 0
    assert capsys.readouterr().out == ""
    assert main(["token", "add", "night", "--role", "operator", "--only", "metrics", "--data", str(tmp_path)]) == 0
    capsys.readouterr()
    assert main(["token", "list", "--data", str(tmp_path)]) == 0
    assert capsys.readouterr().out.split()[-1] == "metrics"
