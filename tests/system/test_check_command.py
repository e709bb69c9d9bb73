"""``gss check device`` against the simulator as a process on a real port."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from gss.instruments.dictionary.read_dictionary import load_dictionary

pytestmark = pytest.mark.timeout(240)


def check(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "gss", "check", "device", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_simulator_keeps_the_interface_document(simulator: str) -> None:
    """The simulator passes every clause that can be checked, also with writes to flash, and is restored afterwards."""
    done = check("--device", simulator, "--write", "--json")
    assert done.stderr == ""
    facts = json.loads(done.stdout)
    wrong = [(c["number"], c["cases"]) for c in facts["clauses"] if c["result"] == "fail"]
    assert (wrong, facts["left"], facts["damaged"], done.returncode) == ([], [], 0, 0)
    assert facts["device"]["serial"] == "SIM-0007"
    assert facts["device"]["dictionary_hash"] == facts["dictionary_hash"] == load_dictionary().hash_hex
    by_number = {c["number"]: c for c in facts["clauses"]}
    tried = [case for c in by_number.values() for case in c["cases"] if case["passed"]]
    assert len(tried) > 200
    assert by_number["6.7"]["result"] == "pass"
    assert {c["result"] for c in by_number.values()} == {"pass", "not checked"}


def test_a_missing_port_is_reported_in_one_line() -> None:
    """Without a device the command gives exit code 2, a message, and nothing on standard output."""
    done = check("--device", "/dev/no-such-port")
    assert done.returncode == 2
    assert done.stdout == ""
    assert "There is no port /dev/no-such-port" in done.stderr
