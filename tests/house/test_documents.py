"""The documents say what is there."""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path

import pytest

from gss.cli import whole_parser
from gss.cli.shell_page import shell_page
from gss.settings import Settings

ROOT = Path(__file__).parents[2]
PAGES = sorted(str(p.relative_to(ROOT)) for p in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])


def test_every_setting_is_documented_with_its_default(root):
    """docs/settings.md has a row for each variable and no other."""
    text = (root / "docs" / "settings.md").read_text()
    rows = dict(re.findall(r"^\| `(GSS_\w+)` \| `?([^`|]*?)`? \|", text, re.MULTILINE))
    expected = {f"GSS_{name.upper()}": str(field.default) or "empty" for name, field in Settings.model_fields.items()}
    assert rows == expected


@pytest.mark.parametrize("page", PAGES)
def test_links_and_pictures_lead_somewhere(root, page):
    """No dead relative link in any document."""
    for target in re.findall(r"\]\(([^)#]+)\)", (root / page).read_text()):
        assert target.startswith("http") or ((root / page).parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES)
def test_commands_of_the_documents_are_understood(page):
    """Each line of a shell block that begins with `gss` is one that the parser takes, options and all."""
    blocks = re.findall(r"^```\w*\n(.*?)^```", (ROOT / page).read_text(), re.MULTILINE | re.DOTALL)
    lines = re.findall(r"^(?:\.venv/bin/)?gss (\S.*)$", "\n".join(blocks).replace("\\\n", " "), re.MULTILINE)
    parser = whole_parser()
    for line in lines:
        parser.parse_args(shlex.split(line.split(" | ")[0].split(" > ")[0], comments=True))
    assert page != "README.md" or len(lines) > 8


def test_the_shells_reference_is_what_the_parsers_say(root):
    """docs/shell.md is written by `gss export shell`."""
    assert (root / "docs" / "shell.md").read_text() == shell_page(whole_parser())


def test_rooms_of_the_architecture_page_exist(root):
    """Every folder that the drawing names is there."""
    drawing = (root / "ARCHITECTURE.md").read_text().split("```")[1]
    for line in drawing.splitlines():
        for name in re.findall(r"^\s*((?:\w+/)+)\s", line):
            found = [root / room / name for room in ("", "gss", "gss/device", "gss/api", "gss/operations")]
            assert any(path.is_dir() for path in found), name


def test_lock_files_name_no_download_host(root):
    """Whoever installs uses their own registry."""
    assert "://" not in (root / "constraints.txt").read_text()
    assert '"resolved"' not in (root / "web" / "package-lock.json").read_text()


def test_the_version_comes_from_one_place(root):
    """pyproject takes it from the package."""
    project = tomllib.loads((root / "pyproject.toml").read_text())
    assert project["project"]["dynamic"] == ["version"]
    assert project["tool"]["hatch"]["version"]["path"] == "gss/__init__.py"
