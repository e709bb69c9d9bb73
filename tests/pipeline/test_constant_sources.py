"""Each constant of each chain states its place in the document, the profile it comes from, or the reason for its value."""

from __future__ import annotations

import re
from dataclasses import fields
from functools import cache
from typing import Any

import numpy as np
import pytest

from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.onboard import Commanded
from gss.pipeline.chains.systems import CONSTANT_SOURCES, SYSTEMS

DOCUMENTS = {
    "sunsat": "Jacobs 1995",
    "cubestar": "Erlank 2013",
    "far_mst": "Huffman 2006",
    "oersted": "Liebe 1992",
    "aim": "Moniteq 1983",
}
PLACE = re.compile(
    r"(Jacobs 1995|Erlank 2013|Huffman 2006|Liebe 1992|Moniteq 1983),? (§|eq\.|Table|Fig\.|app\.|ch\.|')"
)
# Numbers that a document states, with a part of their place. All other numbers come from the profile or from GSS.
FROM_DOCUMENTS: dict[str, dict[str, tuple[float, str]]] = {
    "sunsat": {
        "min_area_px": (10, "§2.2.1.2"),
        "max_area_px": (300, "§2.2.1.2"),
        "max_found": (20, "§2.3"),
        "search_step_px": (3, "§2.2.1.3"),
        "edge_rule": (True, "§2.2.1.3"),
        "max_elongation_px": (10 + 2, "§2.2.3"),
        "elongation_slack_px": (2, "eq. 2.9"),
        "direction_from_px": (5, "§2.2.3"),
        "direction_rad": (np.radians(30), "eq. 2.10"),
        "k_area": (2, "app. C.1"),
        "distance_tolerance_rad": (150e-6, "Table 3-6"),
        "magnitude_tolerance_mag": (0.6, "Table 3-6"),
        "max_observed": (8, "§3.1"),
        "min_group": (3, "§3.3.5"),
        "hint_error_rad": (np.radians(2), "§3.5"),
        "uncertain_adcs_px": (53, "eq. 4.20"),
        "uncertain_least_px": (2, "eq. 4.20"),
        "uncertain_reach_mm": (12, "eq. E.26"),
        "rotation_px": (10 / 2, "§4.1.6.3"),
    },
    "cubestar": {
        "min_area_px": (6, "§5.3.3"),
        "max_area_px": (60, "§5.3.3"),
        "max_invalid": (50, "§5.3.3"),
        "max_centroids": (20, "§5.3.3"),
        "search_step_px": (3, "§4.1.1"),
        "window_px": (5, "§4.1.3"),
        "tolerance_rad": (0.001, "§4.3.5"),
        "vote_margin": (1, "§4.3.3"),
        "tracking_radius_rad": (np.radians(0.3), "§4.5"),
        "assisted_radius_rad": (np.radians(35), "§4.3.4"),
    },
    "far_mst": {"threshold_sigma": (2, "§4.1"), "min_area_px": (4, "§4.2.2")},
    "oersted": {"uncertainty_rad": (np.radians(0.05), "Position-Uncertainty")},
    "aim": {"window_px": (3, "§4.2"), "magnitude_error": (0.5, "§2.1")},
}
# Numbers whose source describes a method of the document; the method, not the number, is published.
BY_METHOD = {
    "sunsat": {"threshold_dn", "k_illum_lux"},
    "cubestar": {"threshold_dn", "edge_rule"},
    "far_mst": {"threshold_dn", "prefilter_count", "max_aspect_ratio", "dark_dn"},
    "oersted": {"averaged"},
    "aim": {"gain"},
}


@cache
def _constants(name: str) -> dict[str, Any]:
    own = SYSTEMS[name].parameters(shipped_camera(name), None, Commanded(), Mode.LOST_IN_SPACE)
    return {f.name: getattr(own, f.name) for f in fields(own)}


@pytest.mark.parametrize("name", DOCUMENTS)
def test_each_constant_has_its_own_source(name: str) -> None:
    """The sources have one entry per constant of the chain and no entry for anything else."""
    assert set(CONSTANT_SOURCES[name]) == set(_constants(name))


@pytest.mark.parametrize("name", DOCUMENTS)
def test_each_source_is_a_place_a_profile_or_a_reason(name: str) -> None:
    """A source contains a place in a document, 'from the profile', or 'GSS' with a reason."""
    for constant, source in CONSTANT_SOURCES[name].items():
        reason = re.search(r"GSS\b.{12,}", source)
        assert PLACE.search(source) or source.startswith("from the profile's ") or reason, (constant, source)


@pytest.mark.parametrize("name", DOCUMENTS)
def test_numbers_of_a_document_have_its_value(name: str) -> None:
    """Each number whose source begins with the document has the value that the document states at that place."""
    constants, sources = _constants(name), CONSTANT_SOURCES[name]
    stated = {
        c
        for c, s in sources.items()
        if re.match(PLACE, s) and not isinstance(constants[c], str) and c not in BY_METHOD[name]
    }
    assert stated == set(FROM_DOCUMENTS[name])
    for constant, (value, place) in FROM_DOCUMENTS[name].items():
        assert constants[constant] == pytest.approx(value, rel=5e-4), constant
        assert place in sources[constant], constant
