"""docs/capabilities.md names only commands, options, pages, experiments and tests that exist."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from gss.cli import full_parser
from gss.device.simulator.options import add_arguments
from validation.entries import ENTRIES

ROOT = Path(__file__).parents[2]
CODE = re.compile(r"`([^`]+)`")
DOCUMENTS = ("Jacobs 1995", "Erlank 2013", "Huffman 2006", "Liebe 1992", "Moniteq 1983")
LEAST_ROWS = 8


def _sections() -> dict[str, list[list[str]]]:
    """Return the rows of the table of each section, by its heading."""
    text = (ROOT / "docs" / "capabilities.md").read_text("utf-8")
    parts = re.split(r"^## (.+)$", text, flags=re.MULTILINE)[1:]
    return {
        heading: [
            [cell.strip() for cell in line.strip("|").split("|")]
            for line in content.splitlines()
            if line.startswith("| ") and not line.startswith(("| capability", "| what"))
        ]
        for heading, content in zip(parts[::2], parts[1::2], strict=True)
    }


def _unknown_words(command: str, parser: argparse.ArgumentParser) -> list[str]:
    """Return the words of a command that are not subcommands, options, values of options, or names of experiments."""
    unknown, previous = [], ""
    for word in command.split()[1:]:
        groups = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
        if word.startswith("--"):
            known = word in parser._option_string_actions
        elif groups:
            known = word in groups[0].choices
            # The simulator is a separate program with its own options.
            parser = _simulator() if word == "simulate" else groups[0].choices.get(word, parser)
        else:
            known = previous.startswith("--") or word in ENTRIES
        if not known:
            unknown.append(word)
        previous = word
    return unknown


def _simulator() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return parser


def test_every_capability_has_a_place_a_use_and_a_test() -> None:
    """Each document has a section, and no row has an empty cell."""
    sections = _sections()
    assert [h for h in sections if h.startswith(DOCUMENTS)] == [
        h for d in DOCUMENTS for h in sections if h.startswith(d)
    ]
    assert sum(h.startswith(DOCUMENTS) for h in sections) == len(DOCUMENTS)
    for heading, rows in sections.items():
        columns = 3 if heading == "Not implemented" else 4
        assert len(rows) >= (LEAST_ROWS if heading.startswith(DOCUMENTS) else 1), heading
        for row in rows:
            assert len(row) == columns, row
            assert all(row), row


def test_commands_pages_experiments_and_tests_exist() -> None:
    """Each command with its options, page, experiment and test that a row names exists, and each row names a use and a test."""
    parser = full_parser()
    routes = set(re.findall(r"path: '([^']+)'", (ROOT / "web" / "src" / "lib" / "routes.ts").read_text("utf-8")))
    for heading, rows in _sections().items():
        if heading == "Not implemented":
            continue
        for _, _, use, tests in rows:
            names = CODE.findall(use)
            assert names, use
            for name in names:
                if name.startswith("/"):
                    assert name in routes, name
                else:
                    assert name.startswith("gss "), name
                    assert _unknown_words(name, parser) == [], name
            assert CODE.findall(tests), tests
            for path in CODE.findall(tests):
                assert (ROOT / "tests" / path).is_file(), path
