"""Counts in words."""

import pytest

from gss.domain.words import counted, verb


@pytest.mark.parametrize(("count", "words"), [(0, "0 frames"), (1, "1 frame"), (2, "2 frames")])
def test_one_is_singular_and_every_other_count_plural(count, words):
    """A count of one has the singular noun, every other count the plural."""
    assert counted(count, "frame") == words


def test_irregular_nouns_and_verbs_follow_the_count():
    """Irregular plurals and verb forms are passed explicitly and selected by the count."""
    assert counted(2, "catalogue entry", "catalogue entries") == "2 catalogue entries"
    assert (verb(1, "is", "are"), verb(3, "is", "are")) == ("is", "are")
