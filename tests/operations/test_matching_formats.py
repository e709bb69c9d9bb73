"""What the ground knows of a unit's matching before anything is sent."""

import pytest

from gss.domain.errors import Conflict
from gss.operations.catalogues.build_catalogue import check_matching


def test_a_bank_the_unit_cannot_match_from_is_not_sent() -> None:
    """CubeStar's format lacks the magnitudes that Sunsat's matching needs; its own formats, and others' units, take theirs."""
    with pytest.raises(Conflict, match="cannot match"):
        check_matching("cubestar", "sunsat")
    for form, camera in (
        ("sunsat", "sunsat"),
        ("sunsat-5", "sunsat"),
        ("cubestar", "oersted"),
        ("cubestar", "cubestar"),
    ):
        check_matching(form, camera)
