"""The constants of the CubeStar chain for any camera, and the transitions between its modes."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.pipeline.chains.cubestar_parameters import SOURCES, CubestarParameters, default_parameters
from gss.pipeline.chains.modes import Mode, next_mode

PARAMETERS = default_parameters(shipped_camera("cubestar"))


def test_mode_transitions_follow_the_state_machine() -> None:
    """With an attitude, the next mode is tracking (0). Without one, tracking falls back to assisted (1), and assisted
    to lost in space (2).
    """
    assert [next_mode(m, True).state for m in Mode] == [0, 0, 0]
    assert {m.state: next_mode(m, False).state for m in Mode} == {0: 1, 1: 2, 2: 2}


@pytest.mark.parametrize("name", [i.name for i in shipped_registry().all() if i.profile.chain])
def test_every_camera_has_parameters(name: str) -> None:
    """Defaults exist for all profiles, thresholds exceed the noise, and each parameter has a source."""
    parameters = default_parameters(shipped_camera(name))
    assert parameters.threshold_dn >= 4 * parameters.noise.dark_sigma_dn - 0.5
    assert parameters.assisted_radius_rad > shipped_camera(name).camera.half_diagonal_rad
    documented = set(SOURCES) | {
        "min_verified_lost",
        "min_verified_assisted",
        "min_verified_tracking",
        "max_small_regions",
    }
    assert set(CubestarParameters.__dataclass_fields__) == documented - {"min_verified"}


@pytest.mark.parametrize(
    "change", [{"undistort": "no"}, {"threshold_dn": 0.0}, {"min_area_px": 61}, {"tolerance_rad": -1.0}]
)
def test_invalid_parameters_are_rejected(change: dict[str, object]) -> None:
    """Invalid parameters raise BadInput when they are constructed."""
    with pytest.raises(BadInput):
        replace(PARAMETERS, **change)  # type: ignore[arg-type]
