"""One server on one database, wherever its data folder is."""

from __future__ import annotations

import subprocess
import sys

import pytest

from gss.domain.errors import Conflict, StoreDown
from gss.store.engine import sole_server


def test_one_sqlite_file_has_one_server(tmp_path):
    """By whatever name the file is given; another file of the folder is independent; the lock ends with its process."""
    (tmp_path / "other name.db").symlink_to(tmp_path / "gss.db")
    hold = (
        f"import sys; from gss.store.engine import sole_server\nwith sole_server('sqlite:///{tmp_path / 'gss.db'}'):\n"
    )
    hold += " print('held', flush=True); sys.stdin.read()"
    first = subprocess.Popen([sys.executable, "-c", hold], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
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
    """The lock ends with the connection that holds it; without a server the database cannot be locked."""
    with sole_server(postgres_url), pytest.raises(Conflict, match="another server runs on this database"):
        sole_server(postgres_url).__enter__()
    with sole_server(postgres_url):
        pass
