"""Long requests: their cost is estimated first, progress is reported, and a cancellation ends them."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from gss.catalogue_tools.build import build, plan, preview, too_heavy
from gss.catalogue_tools.envelope.attitude import AttitudeLimits
from gss.catalogue_tools.envelope.blocks import BlockEnvelope
from gss.catalogue_tools.request import BuildRequest, ElementsOrbit
from gss.catalogue_tools.selection.selection import SelectionRules
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_camera


def deg(*values: float) -> tuple[float, ...]:
    return tuple(float(np.radians(v)) for v in values)


TURN = (-np.pi, np.pi)
ORBIT = ElementsOrbit((deg(97)[0], deg(97)[0]), (0.0, 0.1))
BLOCKS = BuildRequest(
    shipped_camera("cubestar"),
    "cubestar",
    SelectionRules(3.8),
    orbit=ORBIT,
    attitude=AttitudeLimits("zenith", TURN, TURN, TURN),
    start=datetime(2026, 12, 1, tzinfo=UTC),
    method="blocks",
    pointings=200,
)


class Stopped(Exception):
    """Raised to cancel a build, like the cancellation of a job."""


def test_too_many_blocks_are_counted_and_not_previewed() -> None:
    """A preview of fourteen million fields is rejected with their number. A preview of a narrow range is calculated."""
    with pytest.raises(BadInput, match="too many combinations for a preview: 14"):
        preview(BLOCKS, load_stars(3.8))
    narrow = replace(BLOCKS, attitude=AttitudeLimits("zenith", (0.0, 0.0), (0.0, 0.0), (0.0, 0.0)))
    assert preview(narrow, load_stars(3.8)).selection.kept


def test_the_predicted_number_of_fields_is_correct() -> None:
    """The predicted number of fields equals the calculated one, and the reported progress ends at 1."""
    progress: list[float] = []
    limits = AttitudeLimits("zenith", deg(-5, 5), deg(0, 5), deg(0, 10))  # type: ignore[arg-type]
    planned = plan(replace(BLOCKS, attitude=limits), progress.append)
    assert isinstance(planned.base, BlockEnvelope)
    assert planned.base.looked_at == sum(len(a) for a in planned.base._attitudes(0.0)) == 3 * 2 * 3 * 36
    assert planned.base.marked.any()
    assert progress[-1] == pytest.approx(1.0)


def test_whole_blocks_are_fewer_than_blocks_with_the_centre_in_view() -> None:
    """The method whole_blocks marks a part of the blocks that the method blocks marks."""
    limits = AttitudeLimits("zenith", yaw_rad=(0.0, 0.0))
    centre, whole = (plan(replace(BLOCKS, attitude=limits, method=m)).base for m in ("blocks", "whole_blocks"))
    assert isinstance(centre, BlockEnvelope)
    assert isinstance(whole, BlockEnvelope)
    assert 0 < whole.marked.sum() < centre.marked.sum()


def test_a_long_build_can_be_cancelled_during_a_stage() -> None:
    """The stages for blocks and for thinning call the progress callback, whose exception ends the build."""

    def stop(stage: str, share: float) -> None:
        if share > 0:
            raise Stopped

    with pytest.raises(Stopped):
        build(replace(BLOCKS, attitude=AttitudeLimits("zenith", yaw_rad=(0.0, 0.2))), load_stars(3.8), stop)
    frames = BuildRequest(
        shipped_camera("cubestar"), "cubestar", SelectionRules(4.5, brightest_per_field=8, thinning="frames")
    )

    def stop_thinning(stage: str, share: float) -> None:
        if stage == "thinning":
            raise Stopped

    with pytest.raises(Stopped):
        build(frames, load_stars(4.5), stop_thinning)


def test_frames_with_many_stars_are_too_expensive_for_a_preview() -> None:
    """A preview with the 500 brightest stars to V 7 in every frame is rejected as too expensive. With the 8 brightest
    to V 5 it is not.
    """
    stars = load_stars(7.0)
    many_stars = BuildRequest(
        shipped_camera("cubestar"), "cubestar", SelectionRules(7.0, brightest_per_field=500, thinning="frames")
    )
    with pytest.raises(BadInput, match="too many combinations for a preview"):
        preview(many_stars, stars)
    few_stars = replace(many_stars, rules=SelectionRules(5.0, brightest_per_field=8, thinning="frames"))
    assert too_heavy(plan(few_stars), load_stars(5.0)) is None


def test_the_shortest_distance_must_be_below_the_longest() -> None:
    """Distance limits in the wrong order or above the field's diagonal are rejected before fields are counted."""
    for limits in ({"pair_min_rad": 0.3, "pair_max_rad": 0.1}, {"pair_min_rad": 2.0}):
        with pytest.raises(BadInput, match="not below the longest"):
            plan(replace(BLOCKS, **limits))
