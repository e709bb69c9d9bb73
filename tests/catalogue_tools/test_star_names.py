"""Search for stars of the Hipparcos catalogue by number and name."""

from __future__ import annotations

import pytest

from gss.catalogue_tools.sources.hipparcos import load_hipparcos
from gss.catalogue_tools.sources.star_names import find_stars, named_stars


def found(text: str, limit: int = 5) -> list[tuple[str, bool]]:
    """Return name and exactness of the stars that match a text."""
    table = load_hipparcos()
    return [(table.name_of(int(table.hip[star.row])), star.exact) for star in find_stars(text, limit)]


@pytest.mark.parametrize("text", ["betelgeuse", "BETELGEUSE", "HIP 27989", "hip27989", "27989"])
def test_a_name_and_a_number_find_one_star(text: str) -> None:
    """The proper name in any case, and the Hipparcos number with or without its prefix, find the star exactly."""
    assert found(text) == [("Betelgeuse", True)]


@pytest.mark.parametrize("text", ["zeta psc", "ζ Psc", "Zeta  Psc "])
def test_greek_letters_have_their_english_names(text: str) -> None:
    """A Bayer name is found with the Greek letter and with its English name."""
    assert found(text) == [("Revati", True), ("ζ Psc", True)]  # both stars of the double have this designation
    assert found("mu2 cha") == found("μ² Cha") == [("μ² Cha", True)]
    assert found("lambda and") == found("λ And") == [("λ And", True)]


@pytest.mark.parametrize("text", ["alpha ori", "α Ori", "58 Ori"])
def test_a_star_with_a_proper_name_is_found_by_its_designations(text: str) -> None:
    """Bayer and Flamsteed designations find a star that the table lists by its proper name."""
    assert found(text) == [("Betelgeuse", True)]


def test_a_bayer_name_is_found_without_its_number() -> None:
    """α¹ and α² Cen are both found by their common letter, the brighter star first."""
    assert found("alpha cen")[:2] == [("Rigil Kentaurus", True), ("Toliman", True)]


def test_the_number_of_a_variable_star_belongs_to_its_name() -> None:
    """The text "v cyg" has no exact result, although V1057 Cyg and others exist. The text "v pup" has three."""
    assert [name for name, exact in found("v cyg", 9) if exact] == []
    assert {name for name, exact in found("v pup", 9) if exact} == {"V Pup", "v¹ Pup", "v² Pup"}


def test_names_that_start_with_the_text_come_first_and_then_brighter_stars() -> None:
    """The order is: whole name, start of the name, start of a word, other part; within each, by magnitude."""
    assert [name for name, _ in found("bel", 3)] == ["Bellatrix", "Belel", "Terebellum"]
    assert found("rigel", 2)[0] == ("Rigel", True)


def test_a_star_that_the_table_does_not_contain_is_not_found() -> None:
    """Unknown names and numbers, and an empty text, have no result."""
    assert [found(text) for text in ("sirius b", "HIP 999999", "0", "  ", "gaia row 5")] == [[]] * 5
    assert named_stars() == 4535
