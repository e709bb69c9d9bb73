"""Untrusted bytes for every parser: the stored corpus, and mutations of it by hypothesis."""

from __future__ import annotations

import random
import warnings
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tools.fuzz import CORPUS, mutated, seeds_of
from tools.fuzz_targets import TARGETS

pytestmark = pytest.mark.timeout(60)  # an input that hangs a parser fails


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    """Suppress warnings of libraries about unusual files."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@pytest.mark.parametrize("name", TARGETS)
def test_the_stored_corpus_raises_only_our_errors(name: str) -> None:
    """Valid examples and every input for which fuzzing found a defect."""
    inputs = seeds_of(name)
    assert inputs
    for data in inputs:
        TARGETS[name].fuzz_one(data)


@pytest.mark.parametrize("name", TARGETS)
def test_changed_and_random_bytes_raise_only_our_errors(name: str) -> None:
    """A few dozen inputs per target, the same in every run; ``python -m tools.fuzz all`` runs for any time."""
    target, pool = TARGETS[name], seeds_of(name)
    changed = st.integers(0, 2**32 - 1).map(
        lambda seed: mutated(random.Random(seed), pool, target.max_bytes, target.text)
    )
    words = st.text(max_size=200).map(lambda text: text.encode("utf-8", "surrogatepass"))

    @settings(max_examples=30, derandomize=True, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(st.one_of(changed, changed, st.binary(max_size=500), words))
    def nothing_comes_out(data: bytes) -> None:
        target.fuzz_one(data)

    nothing_comes_out()


def test_every_folder_of_the_corpus_has_a_target() -> None:
    """A renamed target keeps its regressions."""
    assert {path.name for path in CORPUS.iterdir() if path.is_dir()} == set(TARGETS)
