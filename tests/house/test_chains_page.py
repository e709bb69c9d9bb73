"""docs/chains.md agrees with the code."""

from __future__ import annotations

from pathlib import Path

import pytest

from gss.pipeline.chains.systems import SYSTEMS
from tools.chain_stages import STAGES
from tools.chains_page import function, text
from tools.chains_reach import unreached


def test_the_page_of_chains_is_current(root: Path) -> None:
    """Constants, sources and functions of the page are those of the running code."""
    assert (root / "docs" / "chains.md").read_text("utf-8") == text(), "run python -m tools.chains_page"


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_every_stage_of_a_chain_is_a_function(name: str) -> None:
    """Each system has detection, identification, attitude and tracking, and every function it names is there."""
    stages = STAGES[name]
    assert len(stages) >= 10
    assert all(callable(function(s)) for s in stages)


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_the_stated_command_calls_the_function_of_each_stage(name: str) -> None:
    """Rows of docs/chains.md are shown by running them; a stage that an option leaves out is not called with it."""
    assert unreached({name: STAGES[name]}) == []
