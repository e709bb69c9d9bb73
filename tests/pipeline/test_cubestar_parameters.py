"""The constants of the CubeStar chain for any camera, and how its modes follow one another."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gss.domain.errors import BadInput
from gss.domain.profiles import PROFILES, profile
from gss.pipeline.chains.cubestar_parameters import SOURCES, CubestarParameters, default_parameters
from gss.pipeline.chains.modes import Mode, next_mode

PARAMETERS = default_parameters(profile("cubestar"))


def test_the_state_machine() -> None:
    """An attitude leads to tracking (0); without one tracking falls to assisted (1), and that to lost in space (2)."""
    assert [next_mode(m, True).state for m in Mode] == [0, 0, 0]
    assert [next_mode(Mode.from_state(s), False).state for s in (0, 1, 2)] == [1, 2, 2]
    assert [Mode.from_state(m.state) for m in Mode] == list(Mode)
    with pytest.raises(BadInput):
        Mode.from_state(3)


@pytest.mark.parametrize("name", list(PROFILES))
def test_every_camera_has_parameters(name: str) -> None:
    """Defaults exist for all profiles, thresholds above noise, and each parameter has a source."""
    p = default_parameters(profile(name))
    assert p.threshold_dn >= 4 * p.noise.dark_sigma_dn - 0.5
    assert p.assisted_radius_rad > profile(name).camera.half_diagonal_rad
    told = set(SOURCES) | {"min_verified_lost", "min_verified_assisted", "min_verified_tracking", "max_small_regions"}
    assert set(CubestarParameters.__dataclass_fields__) == told - {"min_verified"}


@pytest.mark.parametrize(
    "change", [{"undistort": "no"}, {"threshold_dn": 0.0}, {"min_area_px": 61}, {"tolerance_rad": -1.0}]
)
def test_impossible_parameters_are_refused(change: dict[str, object]) -> None:
    """Parameters that cannot work raise BadInput at once."""
    with pytest.raises(BadInput):
        replace(PARAMETERS, **change)  # type: ignore[arg-type]
