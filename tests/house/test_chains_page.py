"""docs/chains.md agrees with the code."""

from __future__ import annotations

from pathlib import Path

import pytest

from gss.pipeline.chains.systems import SYSTEMS
from tools.chain_stages import STAGES
from tools.chains_page import function, text
from tools.chains_reach import unreached


def test_the_page_of_chains_is_current(root: Path) -> None:
    """The page states the constants, sources and functions of the current code."""
    assert (root / "docs" / "chains.md").read_text("utf-8") == text(), "run python -m tools.chains_page"


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_every_stage_of_a_chain_is_a_function(name: str) -> None:
    """Each system has detection, identification, attitude and tracking, and every function that it names exists."""
    stages = STAGES[name]
    assert len(stages) >= 10
    assert all(callable(function(s)) for s in stages)


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_the_stated_command_calls_the_function_of_each_stage(name: str) -> None:
    """The command stated for each row of docs/chains.md calls the function of that row.

    An option that disables a stage disables the call.
    """
    assert unreached({name: STAGES[name]}) == []
