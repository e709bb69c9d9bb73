"""Generate the command reference as one Markdown page from the parsers."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

HEAD = """# Command line

For users of the shell and of scripts. This page lists every command with its options.
`gss export shell --out docs/shell.md` generates it from the commands' help.

Exit codes: 0 done, 1 failed, 2 invalid input, 3 no solution. Environment variables can replace options: see
[settings](settings.md).
"""


def shell_page(parser: argparse.ArgumentParser) -> str:
    """Return the Markdown page: a heading and a table of options for each command, in the order of ``gss --help``."""
    return "\n".join([HEAD, *(_section(command, help_text, leaf) for command, help_text, leaf in _commands(parser))])


def _commands(
    parser: argparse.ArgumentParser, command: str = "gss", help_text: str = ""
) -> Iterator[tuple[str, str, argparse.ArgumentParser]]:
    """Yield (command, help text, parser) of all commands without subcommands."""
    groups = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    if not groups:
        yield command, help_text, parser
        return
    for group in groups:
        help_texts = {choice.dest: choice.help or "" for choice in group._choices_actions}
        for name, child in group.choices.items():
            yield from _commands(child, f"{command} {name}", help_texts.get(name, ""))


def _section(command: str, help_text: str, parser: argparse.ArgumentParser) -> str:
    actions = [a for a in parser._actions if not isinstance(a, argparse._HelpAction)]
    rows = "".join(f"| {_name(a)} | {_meaning(a, parser)} |\n" for a in actions)
    table = f"\n| argument | meaning |\n|---|---|\n{rows}" if rows else ""
    sentence = help_text[:1].upper() + help_text[1:]
    return f"## `{command}`\n\n{_cell(sentence)}{'' if sentence.endswith('.') else '.'}\n{table}"


def _name(action: argparse.Action) -> str:
    if not action.option_strings:
        name = action.metavar if isinstance(action.metavar, str) else action.dest
        return f"`{name}`"
    value_text = "" if action.nargs == 0 else f" {_value(action)}"
    return f"`{action.option_strings[-1]}{value_text}`"


def _value(action: argparse.Action) -> str:
    if action.choices and action.metavar is None:
        return "{" + ",".join(str(c) for c in action.choices) + "}"
    if isinstance(action.metavar, tuple):
        return " ".join(action.metavar)
    return str(action.metavar or action.dest.upper())


def _meaning(action: argparse.Action, parser: argparse.ArgumentParser) -> str:
    help_text = parser._get_formatter()._expand_help(action) if action.help else ""
    return _cell(help_text + (" (required)" if action.required and action.option_strings else ""))


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")
