"""Shared fixtures, and the rule about skips: a missing browser or database server is a printed reason on a laptop and a
failure in continuous integration (GSS_TEST_FORBID_SKIPS=1)."""

from __future__ import annotations

import glob
import os
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PHOTOGRAPHS = Path(os.environ.get("GSS_SKY_PHOTOGRAPHS", ROOT.parent / "shared" / "data" / "sky-photographs"))


def pytest_runtest_setup(item: pytest.Item) -> None:
    needs = {
        "browser": (chromium() is not None, "no chromium here: apt install chromium"),
        "postgres": (postgres_bin() is not None, "no PostgreSQL server here: apt install postgresql"),
        "photographs": (PHOTOGRAPHS.is_dir(), "the folder of sky photographs is absent (GSS_SKY_PHOTOGRAPHS)"),
    }
    for marker, (present, reason) in needs.items():
        if item.get_closest_marker(marker) and not present:
            if os.environ.get("GSS_TEST_FORBID_SKIPS") and marker != "photographs":
                pytest.fail(reason)
            pytest.skip(reason)


def chromium() -> str | None:
    """The browser's program."""
    return shutil.which("chromium")


def postgres_bin() -> Path | None:
    """Folder of the newest PostgreSQL server's programs."""
    found = sorted(glob.glob("/usr/lib/postgresql/*/bin/postgres"))
    return Path(found[-1]).parent if found else None


@pytest.fixture(scope="session")
def root() -> Path:
    """The repository's root."""
    return ROOT


@pytest.fixture(scope="session")
def photographs() -> Path:
    """The folder of sky photographs."""
    return PHOTOGRAPHS
