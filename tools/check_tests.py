"""Run the fast tests of the changed files: ``python -m tools.check_tests [--base REV]``.

A file has changed if it differs from the base (the last commit) or is not tracked by Git. The selected tests are
changed test files, tests that name a changed module, and tests of the interface if the description of an instrument has
changed. Tests that start processes or browsers (``SLOW``) are not selected; ``make test`` runs them.
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
"""Tests that read the descriptions of instruments. They run if a YAML file of ``gss/instruments`` has changed."""
MAX_FILES = 25
"""Maximum number of test files to run, which limits the run to about a minute. Files that name the most changed modules
run first."""


def changed_files(base: str) -> list[str]:
    """Return the paths that differ from ``base`` or are untracked."""
    listings = (["git", "diff", "--name-only", base], ["git", "ls-files", "--others", "--exclude-standard"])
    outputs = [subprocess.run(command, capture_output=True, text=True, check=True).stdout for command in listings]
    return sorted({line for text in outputs for line in text.splitlines()})


def module_of(path: str) -> str:
    """Return the module name of a path, for example gss.a.b for gss/a/b.py."""
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def tests_of(changed: Iterable[str], tests: Iterable[Path]) -> list[str]:
    """Return the test files that have changed or name a changed module; changed files first, then by number of named
    modules."""
    changed = list(changed)
    modules = [
        module_of(path)
        for path in changed
        if path.startswith(("gss/", "validation/", "tools/")) and path.endswith(".py")
    ]
    pattern = re.compile("|".join(rf"\b{re.escape(module)}\b" for module in modules)) if modules else None
    has_changed_description = any(path.startswith("gss/instruments/") and path.endswith(".yaml") for path in changed)
    ranked = []
    for test in tests:
        name = test.as_posix()
        if name.startswith(SLOW):
            continue
        named_modules = len(set(pattern.findall(test.read_text()))) if pattern else 0
        if name in changed or named_modules or (has_changed_description and name.startswith(DESCRIBED)):
            ranked.append((name not in changed, -named_modules, name))
    return [name for *_, name in sorted(ranked)]


def main() -> int:
    """Run the tests. Returns pytest's exit status; 0 if there is nothing to test."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--base", default="HEAD", help="compare with this revision (default HEAD)")
    selected = tests_of(changed_files(parser.parse_args().base), sorted(Path("tests").rglob("test_*.py")))
    if not selected:
        print("No fast test names a changed module")
        return 0
    for skipped in selected[MAX_FILES:]:
        print(f"Not run here, see make test: {skipped}")
    command = [sys.executable, "-m", "pytest", "-q", "-n", "2", "--dist", "loadfile", *selected[:MAX_FILES]]
    return subprocess.run(command, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
