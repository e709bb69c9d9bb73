"""Catalogue for several heads on one body: the union of the stars that each head sees."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest

from gss.catalogue_tools.build import prepare, preview
from gss.catalogue_tools.envelope.attitude import AttitudeLimits, mounting_of
from gss.catalogue_tools.envelope.occultation import Occultation
from gss.catalogue_tools.envelope.sweep import sweep
from gss.catalogue_tools.plan import plan
from gss.catalogue_tools.quick_look import QuickLook
from gss.catalogue_tools.request import BuildRequest, ElementsOrbit, parameters_of, request_from
from gss.catalogue_tools.selection.selection import SelectionRules
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_camera

SMALL_ANGLE_RAD = float(np.radians(2.0))
MOUNTINGS = [
    m for turns in ([180.0, 0.0, 0.0], [120.0, 0.0, 0.0], [150.0, 50.0, 0.0]) if (m := mounting_of(None, turns))
]


def request(pointing: str, **values: Any) -> BuildRequest:
    """Return a request with small attitude limits."""
    camera = shipped_camera("cubestar")
    limits = AttitudeLimits(
        pointing,
        (-SMALL_ANGLE_RAD, SMALL_ANGLE_RAD),
        (-SMALL_ANGLE_RAD, SMALL_ANGLE_RAD),
        (-SMALL_ANGLE_RAD, SMALL_ANGLE_RAD),
        ra_rad=1.5,
        dec_rad=0.3,
    )
    orbit = ElementsOrbit((1.7, 1.7), (0.2, 0.4)) if pointing == "zenith" else None
    defaults = {
        "orbit": orbit,
        "attitude": limits,
        "start": datetime(2026, 12, 1, tzinfo=UTC),
        "days": 5.0,
        "pointings": 200,
    }
    return BuildRequest(camera, "cubestar", SelectionRules(4.5), **(defaults | values))


def with_one_head(multi_head: BuildRequest, mounting: tuple[float, ...]) -> BuildRequest:
    """Return the request for a single head with this mounting."""
    assert multi_head.attitude is not None
    return replace(multi_head, heads=(), attitude=replace(multi_head.attitude, body_from_cam=mounting))


@pytest.mark.parametrize("pointing", ["zenith", "inertial"])
def test_the_union_contains_the_stars_of_each_head(pointing: str) -> None:
    """A star is in the catalogue if and only if at least one head alone would include it.

    Map, edges and preview are also unions.
    """
    several = request(pointing, heads=tuple(MOUNTINGS))
    stars = load_stars(4.5).icrs
    combined, single_heads = plan(several), [plan(with_one_head(several, m)) for m in MOUNTINGS]
    in_single_head = [head.envelope.contains(stars) for head in single_heads]
    assert np.array_equal(combined.envelope.contains(stars), np.logical_or.reduce(in_single_head))
    assert all(np.count_nonzero(~in_single_head[k] & combined.envelope.contains(stars)) for k in range(3))
    assert len(combined.envelope.edges(at_end=False)) == sum(
        len(head.envelope.edges(at_end=False)) for head in single_heads
    )
    visible = combined.envelope.time_fraction(stars) > 0
    assert np.all(visible[np.logical_or.reduce([head.envelope.time_fraction(stars) > 0 for head in single_heads])])
    quick_look = QuickLook(combined)
    assert np.count_nonzero(quick_look.contains(stars) != combined.envelope.contains(stars)) <= 1
    rng = np.random.default_rng(1)
    for cams in (
        combined.envelope.attitudes(rng, 60),
        combined.envelope.at(rng.random((60, combined.envelope.dimensions))).cam_from_icrs,
    ):
        assert all(any(head.envelope.contains(cam[2:])[0] for head in single_heads) for cam in cams)
    assert len(sweep(combined.base, combined.shape).fields) >= 1


def test_the_selected_stars_are_those_of_each_head() -> None:
    """Selection and lifetime use the union. The lifetime is the shortest one of the heads."""
    several = request("zenith", heads=tuple(MOUNTINGS[:2]), bank_bytes=256 * 1024)
    prepared = prepare(several, load_stars(4.5))
    chosen = {int(h) for h in prepared.selection.kept.hip}
    for mounting in MOUNTINGS[:2]:
        of_one_head = {int(h) for h in prepare(with_one_head(several, mounting), load_stars(4.5)).selection.kept.hip}
        assert of_one_head <= chosen
        assert len(of_one_head) < len(chosen)
    lifetimes = [plan(with_one_head(several, m)).lifetime().days for m in MOUNTINGS[:2]]
    assert plan(several).lifetime().days == pytest.approx(min(lifetimes))
    assert preview(several, load_stars(4.5)).selection.count is not None


def test_the_manifest_keeps_the_heads() -> None:
    """The request restored from its parameters has the same heads. Older parameters have none."""
    several = request("zenith", heads=tuple(MOUNTINGS))
    assert request_from(parameters_of(several), several.profile) == several
    old = {name: value for name, value in parameters_of(several).items() if name != "heads"}
    assert request_from(old, several.profile).heads == ()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"attitude": None, "orbit": None}, "no limits of attitude"),
        ({"method": "blocks"}, "the method blocks"),
        ({"occultation": Occultation(altitude_m=600e3)}, "occultation"),
        ({"heads": ((1.0,) * 9,)}, "not a rotation"),
        ({"heads": tuple(MOUNTINGS) * 3}, "too many heads"),
    ],
)
def test_single_camera_options_are_rejected_with_several_heads(values: dict[str, Any], message: str) -> None:
    """Options that support only a single camera are rejected with several heads, and the error names the option."""
    with pytest.raises(BadInput, match=message):
        request("zenith", **({"heads": tuple(MOUNTINGS)} | values))
