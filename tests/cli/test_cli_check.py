"""Output of ``gss check device`` for every kind of finding."""

from __future__ import annotations

import pytest

from gss.cli import main
from gss.cli.check import _print
from gss.operations.checks.check_findings import Findings

DEVICE: dict[str, object] = {"serial": "X-1", "device_model": "m", "profile": "cubestar", "firmware": "f"}


def test_a_failed_clause_is_shown_with_its_number_sentence_and_trial(capsys: pytest.CaptureFixture[str]) -> None:
    """A passed clause has one line. Failed and skipped test cases are listed below their clause."""
    findings = Findings(not_restored=["mode is tracking, was standby"], damaged=3)
    findings.check("4.5", "code 255", True)
    findings.check("4.6", "SET_EXPOSURE with 1 B", False, "accepted, completed")
    findings.skip("4.3", "RESET", "hazardous")
    _print(findings, DEVICE)
    lines = capsys.readouterr().out.splitlines()
    assert "X-1: m, cubestar, firmware f" in lines
    assert (
        "pass        4.5   A command code that the dictionary does not define is rejected (`unknown_command`)." in lines
    )
    failed_line = lines.index("fail        4.6   Arguments of the wrong length are rejected (`bad_length`).")
    assert lines[failed_line + 1].strip() == "FAILED: SET_EXPOSURE with 1 B: accepted, completed"
    assert "skipped: RESET: hazardous" in [line.strip() for line in lines]
    assert "NOT RESTORED: mode is tracking, was standby" in lines
    assert lines[-2].startswith("3 packets were damaged")
    assert lines[-1] == "2 test cases, 1 failed; failed clauses: 1"


def test_link_keys_are_refused_for_a_protocol_without_them(capsys: pytest.CaptureFixture[str]) -> None:
    """The packets of a third-party sensor cannot be signed."""
    assert (
        main(["check", "device", "--device", "socket://127.0.0.1:1", "--instrument", "sagitta", "--keys", "k.json"])
        == 2
    )
    assert "has no link keys" in capsys.readouterr().err
