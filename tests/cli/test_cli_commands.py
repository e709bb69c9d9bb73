"""The command line as a whole: names, summaries, and what is imported for them."""

from __future__ import annotations

import subprocess
import sys

from gss.cli import COMMANDS, full_parser


def test_every_command_of_the_table_is_registered_by_its_module():
    """The table that lists commands without importing them names exactly those that exist."""
    (action,) = (a for a in full_parser()._actions if a.dest == "command")
    assert list(action.choices) == list(COMMANDS)


def test_help_imports_no_science():
    """``gss --help`` loads neither numpy nor a module of a command."""
    code = "import sys; from gss.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = done.stdout.splitlines()[-1].split()
    assert not {"numpy", "fastapi", "sqlalchemy", "gss.cli.serve"} & set(loaded)
    assert all(name in done.stdout for name in COMMANDS)
