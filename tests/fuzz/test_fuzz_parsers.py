"""Untrusted bytes for every parser: the stored corpus, and its mutations by hypothesis."""

from __future__ import annotations

import random
import time
import warnings
from collections.abc import Iterator
from contextlib import suppress

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gss.domain.errors import BadInput, GssError
from tools.fuzz import CORPUS, InputTimeoutError, mutated, search, seeds_of
from tools.fuzz_contract import Target
from tools.fuzz_targets import TARGETS

pytestmark = pytest.mark.timeout(60)  # an input that hangs a parser fails


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    """Suppress warnings of libraries about unusual files."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@pytest.mark.parametrize("name", TARGETS)
def test_the_stored_corpus_raises_only_gss_errors(name: str) -> None:
    """Valid examples, and every input that revealed a defect, are parsed or rejected with an error of GSS."""
    inputs = seeds_of(name)
    assert inputs
    for data in inputs:
        TARGETS[name].fuzz_one(data)


@pytest.mark.parametrize("name", TARGETS)
def test_changed_and_random_bytes_raise_only_gss_errors(name: str) -> None:
    """Mutated and random inputs are parsed or rejected with an error of GSS. The inputs are the same in every run;
    ``python -m tools.fuzz all`` runs for any duration.
    """
    target, pool = TARGETS[name], seeds_of(name)
    mutations = st.integers(0, 2**32 - 1).map(
        lambda seed: mutated(random.Random(seed), pool, target.max_bytes, target.text)
    )
    words = st.text(max_size=200).map(lambda text: text.encode("utf-8", "surrogatepass"))

    @settings(max_examples=30, derandomize=True, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(st.one_of(mutations, mutations, st.binary(max_size=500), words))
    def only_gss_errors(data: bytes) -> None:
        target.fuzz_one(data)

    only_gss_errors()


def test_every_folder_of_the_corpus_has_a_target() -> None:
    """Each folder of the corpus has a target of the same name, so that a renamed target keeps its regression inputs."""
    assert {path.name for path in CORPUS.iterdir() if path.is_dir()} == set(TARGETS)


@pytest.mark.timeout(60, method="thread")  # the search uses the timer of the other method
@pytest.mark.parametrize("converted", [Exception, BaseException])
def test_an_input_that_hangs_a_parser_is_kept(monkeypatch: pytest.MonkeyPatch, converted: type[BaseException]) -> None:
    """The search stops an input at the time limit and keeps it, also if the parser converts every exception."""

    def hang(_: bytes) -> None:
        with suppress(GssError):
            try:
                time.sleep(5)
            except converted as error:
                raise BadInput("the file cannot be read") from error

    monkeypatch.setitem(TARGETS, "image", Target(hang))
    kept: list[type[BaseException]] = []
    count, slowest_s = search("image", 0.01, 1, lambda _, error: kept.append(type(error)), max_s=0.05)
    assert (count, kept) == (1, [InputTimeoutError])
    assert slowest_s < 5
