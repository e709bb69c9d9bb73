"""Command line: names of the commands and modules that are imported for the help."""

from __future__ import annotations

import importlib
import subprocess
import sys

from gss.cli import COMMANDS, full_parser, main


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


def test_an_interrupt_during_the_import_of_a_command_is_one_line(monkeypatch, capsys):
    """Ctrl-C before the command runs gives exit code 130 and no traceback."""

    def interrupted(name: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(importlib, "import_module", interrupted)
    assert main(["solve", "frame.png", "--blind"]) == 130
    assert capsys.readouterr().err == "gss: Interrupted.\n"
