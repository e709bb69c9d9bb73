"""docs/chains.md agrees with the code."""

from __future__ import annotations

from pathlib import Path

import pytest

from gss.pipeline.chains.systems import SYSTEMS
from tools.chains_page import STAGES, function, text


def test_the_page_of_chains_is_current(root: Path) -> None:
    """Constants, sources and functions of the page are those of the running code."""
    assert (root / "docs" / "chains.md").read_text("utf-8") == text(), "run python -m tools.chains_page"


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_every_stage_of_a_chain_is_a_function(name: str) -> None:
    """Each system has detection, identification, attitude and tracking, and every function it names is there."""
    stages = STAGES[name]
    assert len(stages) >= 10
    assert all(callable(function(s.where)) for s in stages)
