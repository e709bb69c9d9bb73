"""Counts in words."""

import pytest

from gss.domain.words import counted, verb


@pytest.mark.parametrize(("count", "words"), [(0, "0 frames"), (1, "1 frame"), (2, "2 frames")])
def test_one_is_singular_and_everything_else_plural(count, words):
    """A report never says "1 frames"."""
    assert counted(count, "frame") == words


def test_irregular_nouns_and_verbs_follow_the_count():
    """Irregular plurals are stated explicitly."""
    assert counted(2, "catalogue entry", "catalogue entries") == "2 catalogue entries"
    assert (verb(1, "is", "are"), verb(3, "is", "are")) == ("is", "are")
