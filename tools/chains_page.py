"""Write docs/chains.md: every stage of every chain with its function and source, and every constant with its source.

    .venv/bin/python -m tools.chains_page

The tool runs the command of every stage. It writes nothing if a command does not call the function of its stage
(:mod:`tools.chains_reach`). Constants and their sources are read from the running code.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np

from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.onboard import Commanded
from gss.pipeline.chains.options import names
from gss.pipeline.chains.systems import CONSTANT_SOURCES, system
from tools.chain_stages import STAGES, ChainStage
from tools.chains_reach import unreached

PAGE = Path(__file__).parent.parent / "docs" / "chains.md"


TITLES = {
    "sunsat": "Jacobs 1995, chapters 2 to 4",
    "cubestar": "Erlank 2013, chapters 4 and 5",
    "far_mst": "Huffman 2006",
    "oersted": "Liebe 1992",
    "aim": "Moniteq 1983",
}


def function(stage: ChainStage) -> Any:
    """Return the function of a stage. Raises ImportError or AttributeError if it does not exist."""
    module, name = stage.full_name.split(":")
    value = importlib.import_module(module)
    for part in name.split("."):
        value = getattr(value, part)
    return value


def text() -> str:
    """Return the page."""
    parts = [
        "# Algorithms of each system",
        "",
        "For engineers. This page lists the algorithms of each system stage by stage, with the function, the section of the",
        "publication, and how to select the stage on the command line: `gss solve FILE --camera X --chain X …`.",
        "A test runs each command and checks that it calls the function. Constants are those for the system's camera and",
        "exposure; `--set NAME=VALUE` changes one within its limits. An on-board calibration or parameter table changes the",
        "numbers it contains. Stages marked *GSS* are not in the publication; they run after its algorithm and can only",
        "reject a result.",
        "`python -m tools.chains_page` generates this page.",
        "",
    ]
    for name, stages in STAGES.items():
        parts += [
            f"## {name}: {TITLES[name]}",
            "",
            "| stage | function | source | selected with |",
            "|---|---|---|---|",
        ]
        for s in stages:
            function(s)
            module, called = s.where.split(":")
            module = module.removeprefix("gss.")
            parts.append(f"| {s.what} | `{module}.{called}` | {s.source} | {s.selected_with} |")
        parts += ["", "| constant | value | source |", "|---|---:|---|", *_constants(name), ""]
    return "\n".join(parts).rstrip() + "\n"


def _constants(name: str) -> list[str]:
    own = system(name).parameters(shipped_camera(name), None, Commanded(), Mode.LOST_IN_SPACE)
    sources = CONSTANT_SOURCES[name]
    rows = []
    for constant in names(own):
        source = sources[constant].replace("|", "/")
        rows.append(f"| `{constant}` | {_value(getattr(own, constant))} | {source} |")
    return rows


def _value(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        return f"{value:.4g}"
    if isinstance(value, tuple):
        return ", ".join(_value(v) for v in value)
    return f"{value}"


def main() -> int:
    """Write the page if every stage is reached. Return 1 if a stage is not reached."""
    missing = unreached(STAGES)
    for line in missing:
        print(line)
    if not missing:
        PAGE.write_text(text(), "utf-8")
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main())
