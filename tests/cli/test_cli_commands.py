"""Command line: names of the commands and modules that are imported for the help."""

from __future__ import annotations

import subprocess
import sys

from gss.cli import COMMANDS, full_parser


def test_every_command_of_the_table_is_registered_by_its_module():
    """The table of commands, which is read without importing their modules, names exactly the registered commands."""
    (action,) = (a for a in full_parser()._actions if a.dest == "command")
    assert list(action.choices) == list(COMMANDS)


def test_help_imports_no_science():
    """``gss --help`` imports neither numpy nor the module of a command."""
    code = "import sys; from gss.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = done.stdout.splitlines()[-1].split()
    assert not {"numpy", "fastapi", "sqlalchemy", "gss.cli.serve"} & set(loaded)
    assert all(name in done.stdout for name in COMMANDS)
