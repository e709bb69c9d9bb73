"""Only one server can run on a database."""

from __future__ import annotations

import subprocess
import sys

import pytest

from gss.domain.errors import Conflict, StoreDown
from gss.store.engine import sole_server


def test_one_sqlite_file_has_one_server(tmp_path):
    """A second server is rejected under any name of the file. Other files in the folder are independent, and the lock ends
    with its process."""
    (tmp_path / "other name.db").symlink_to(tmp_path / "gss.db")
    program = (
        f"import sys; from gss.store.engine import sole_server\nwith sole_server('sqlite:///{tmp_path / 'gss.db'}'):\n"
    )
    program += " print('held', flush=True); sys.stdin.read()"
    first = subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert first.stdout is not None
        assert first.stdout.readline() == "held\n"
        for name in ("gss.db", "other name.db"):
            with pytest.raises(Conflict, match="another server runs on this database"):
                sole_server(f"sqlite:///{tmp_path / name}").__enter__()
        with sole_server(f"sqlite:///{tmp_path / 'second.db'}"), sole_server("sqlite://"):
            pass
        first.kill()
        first.wait()
        with sole_server(f"sqlite:///{tmp_path / 'gss.db'}"):
            pass
    finally:
        first.kill()
        first.communicate()
    with pytest.raises(StoreDown, match="folder"):
        sole_server(f"sqlite:///{tmp_path / 'no such folder' / 'gss.db'}").__enter__()


def test_one_postgresql_database_has_one_server(postgres_url):
    """A second server is rejected while the first one holds the lock. The lock ends with the connection that holds it."""
    with sole_server(postgres_url), pytest.raises(Conflict, match="another server runs on this database"):
        sole_server(postgres_url).__enter__()
    with sole_server(postgres_url):
        pass
