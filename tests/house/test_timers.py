"""The time of every attempt of a test is limited, also after a failure."""

from __future__ import annotations

import os
import subprocess
import sys

TESTS = """
import time
import pytest

attempts = []

@pytest.fixture
def slow_to_end():
    yield
    time.sleep(300)

def test_first_starts_what_the_session_shares():
    pass

@pytest.mark.timeout(1)
def test_second_attempt_waits():
    attempts.append(1)
    assert len(attempts) > 1
    time.sleep(300)

@pytest.mark.timeout(1)
def test_fixture_waits_after_a_failure(slow_to_end):
    assert False

def test_last_ends_what_the_session_shares():
    pass
"""


def test_a_second_attempt_and_the_end_after_a_failure_are_limited(root, tmp_path):
    """pytest-timeout limits only what happens before the first failure; tests/conftest.py limits teardown and second attempt."""
    (tmp_path / "test_waits.py").write_text(TESTS)
    options = ["-p", "conftest", "-p", "no:cacheprovider", "-c", root / "pyproject.toml"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, "--rootdir", tmp_path, tmp_path / "test_waits.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": f"{root / 'tests'}:{root}"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert "2 failed, 2 passed, 1 error" in done.stdout
