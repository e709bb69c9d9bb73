"""Checks of a unit's matching format on the ground before anything is sent."""

import pytest

from gss.domain.errors import Conflict
from gss.instruments.registry import shipped_camera
from gss.operations.catalogues.build_catalogue import check_matching


def test_a_bank_that_the_unit_cannot_match_with_is_not_sent() -> None:
    """CubeStar's format, which lacks the magnitudes that Sunsat's matching needs, is rejected for Sunsat. Formats with which
    the unit can match are accepted."""
    with pytest.raises(Conflict, match="cannot match"):
        check_matching("cubestar", shipped_camera("sunsat"))
    for form, camera in (
        ("sunsat", "sunsat"),
        ("sunsat-5", "sunsat"),
        ("cubestar", "oersted"),
        ("cubestar", "cubestar"),
    ):
        check_matching(form, shipped_camera(camera))
