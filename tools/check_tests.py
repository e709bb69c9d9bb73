"""Run the fast tests of what changed: ``python -m tools.check_tests [--base REV]``.

A file has changed if it differs from the base (the last commit) or is not tracked by Git yet. Run are: changed test files, tests
that name a changed module, and tests of the interface if the description of an instrument changed. Tests that drive processes
or browsers (``SLOW``) are left to ``make test``.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

SLOW = ("tests/system", "tests/e2e", "tests/contract", "tests/fuzz")
DESCRIBED = (
    "tests/instruments/",
    "tests/device/test_codec",
    "tests/device/test_other_unit",
    "tests/device/test_packet_bytes",
)
"""Tests that read the descriptions of instruments: run when a YAML file of ``gss/instruments`` changes."""
MAX_FILES = 25
"""More changed tests than this do not fit into a minute: those nearest to the change run first."""


def changed_files(base: str) -> list[str]:
    """Paths that differ from ``base``, and untracked ones."""
    listings = (["git", "diff", "--name-only", base], ["git", "ls-files", "--others", "--exclude-standard"])
    outputs = [subprocess.run(command, capture_output=True, text=True, check=True).stdout for command in listings]
    return sorted({line for text in outputs for line in text.splitlines()})


def module_of(path: str) -> str:
    """``gss/a/b.py`` as ``gss.a.b``."""
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def tests_of(changed: Iterable[str], tests: Iterable[Path]) -> list[str]:
    """Test files that changed or name a changed module, those with the most names first."""
    changed = list(changed)
    modules = [
        module_of(path)
        for path in changed
        if path.startswith(("gss/", "validation/", "tools/")) and path.endswith(".py")
    ]
    pattern = re.compile("|".join(rf"\b{re.escape(module)}\b" for module in modules)) if modules else None
    described = any(path.startswith("gss/instruments/") and path.endswith(".yaml") for path in changed)
    ranked = []
    for test in tests:
        name = test.as_posix()
        if name.startswith(SLOW):
            continue
        named = len(set(pattern.findall(test.read_text()))) if pattern else 0
        if name in changed or named or (described and name.startswith(DESCRIBED)):
            ranked.append((name not in changed, -named, name))
    return [name for *_, name in sorted(ranked)]


def main() -> int:
    """Run the tests. Returns pytest's exit status; 0 if there is nothing to test."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--base", default="HEAD", help="compare with this revision (default HEAD)")
    chosen = tests_of(changed_files(parser.parse_args().base), sorted(Path("tests").rglob("test_*.py")))
    if not chosen:
        print("no fast test names what changed")
        return 0
    for left_out in chosen[MAX_FILES:]:
        print(f"left to make test: {left_out}")
    command = [sys.executable, "-m", "pytest", "-q", "-n", "2", "--dist", "loadfile", *chosen[:MAX_FILES]]
    return subprocess.run(command, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
