"""A catalogue for several heads of one body: the union of what each of them sees."""

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

FEW = float(np.radians(2.0))
MOUNTINGS = [
    m for turns in ([180.0, 0.0, 0.0], [120.0, 0.0, 0.0], [150.0, 50.0, 0.0]) if (m := mounting_of(None, turns))
]


def request(pointing: str, **values: Any) -> BuildRequest:
    camera = shipped_camera("cubestar")
    limits = AttitudeLimits(pointing, (-FEW, FEW), (-FEW, FEW), (-FEW, FEW), ra_rad=1.5, dec_rad=0.3)
    orbit = ElementsOrbit((1.7, 1.7), (0.2, 0.4)) if pointing == "zenith" else None
    made = {
        "orbit": orbit,
        "attitude": limits,
        "start": datetime(2026, 12, 1, tzinfo=UTC),
        "days": 5.0,
        "pointings": 200,
    }
    return BuildRequest(camera, "cubestar", SelectionRules(4.5), **(made | values))


def alone(several: BuildRequest, mounting: tuple[float, ...]) -> BuildRequest:
    assert several.attitude is not None
    return replace(several, heads=(), attitude=replace(several.attitude, body_from_cam=mounting))


@pytest.mark.parametrize("pointing", ["zenith", "inertial"])
def test_the_union_holds_the_stars_of_each_head(pointing: str) -> None:
    """A star is in the catalogue if and only if a head alone would have it. Map, border and preview are the union, too."""
    several = request(pointing, heads=tuple(MOUNTINGS))
    stars = load_stars(4.5).icrs
    p, each = plan(several), [plan(alone(several, m)) for m in MOUNTINGS]
    held = [one.envelope.contains(stars) for one in each]
    assert np.array_equal(p.envelope.contains(stars), np.logical_or.reduce(held))
    assert all(np.count_nonzero(~held[k] & p.envelope.contains(stars)) for k in range(3))
    assert len(p.envelope.edges(at_end=False)) == sum(len(one.envelope.edges(at_end=False)) for one in each)
    seen = p.envelope.time_fraction(stars) > 0
    assert np.all(seen[np.logical_or.reduce([one.envelope.time_fraction(stars) > 0 for one in each])])
    quick = QuickLook(p)
    assert np.count_nonzero(quick.contains(stars) != p.envelope.contains(stars)) <= 1
    rng = np.random.default_rng(1)
    for cams in (p.envelope.attitudes(rng, 60), p.envelope.at(rng.random((60, p.envelope.dimensions))).cam_from_icrs):
        assert all(any(one.envelope.contains(cam[2:])[0] for one in each) for cam in cams)
    assert len(sweep(p.base, p.shape).fields) >= 1


def test_the_selected_stars_are_those_of_each_head() -> None:
    """Selection, quality and lifetime use the union; the lifetime is that of the head whose stars are out of use first."""
    several = request("zenith", heads=tuple(MOUNTINGS[:2]), bank_bytes=256 * 1024)
    ready = prepare(several, load_stars(4.5))
    chosen = {int(h) for h in ready.selection.kept.hip}
    for mounting in MOUNTINGS[:2]:
        own = {int(h) for h in prepare(alone(several, mounting), load_stars(4.5)).selection.kept.hip}
        assert own <= chosen
        assert len(own) < len(chosen)
    lives = [plan(alone(several, m)).lifetime().days for m in MOUNTINGS[:2]]
    assert plan(several).lifetime().days == pytest.approx(min(lives))
    assert preview(several, load_stars(4.5)).selection.count is not None


def test_the_manifest_keeps_the_heads() -> None:
    """The request of a manifest is the request that was built."""
    several = request("zenith", heads=tuple(MOUNTINGS))
    assert request_from(parameters_of(several), several.profile) == several
    old = {name: value for name, value in parameters_of(several).items() if name != "heads"}
    assert request_from(old, several.profile).heads == ()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"attitude": None, "orbit": None}, "no limits of attitude"),
        ({"method": "blocks"}, "the method blocks"),
        ({"occultation": Occultation(altitude_m=600e3)}, "occultation"),
        ({"heads": ((1.0,) * 9,)}, "not a rotation"),
        ({"heads": tuple(MOUNTINGS) * 3}, "too many heads"),
    ],
)
def test_what_is_for_one_camera_is_refused(values: dict[str, Any], words: str) -> None:
    """The error names the option."""
    with pytest.raises(BadInput, match=words):
        request("zenith", **({"heads": tuple(MOUNTINGS)} | values))
