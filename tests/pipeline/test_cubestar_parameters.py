"""The constants of the CubeStar chain for any camera, and how its modes follow one another."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.pipeline.chains.cubestar_parameters import SOURCES, CubestarParameters, default_parameters
from gss.pipeline.chains.modes import Mode, next_mode

PARAMETERS = default_parameters(shipped_camera("cubestar"))


def test_the_state_machine() -> None:
    """An attitude leads to tracking (0); without one tracking falls to assisted (1), and that to lost in space (2)."""
    assert [next_mode(m, True).state for m in Mode] == [0, 0, 0]
    assert {m.state: next_mode(m, False).state for m in Mode} == {0: 1, 1: 2, 2: 2}


@pytest.mark.parametrize("name", [i.name for i in shipped_registry().all() if i.profile.chain])
def test_every_camera_has_parameters(name: str) -> None:
    """Defaults exist for all profiles, thresholds above noise, and each parameter has a source."""
    p = default_parameters(shipped_camera(name))
    assert p.threshold_dn >= 4 * p.noise.dark_sigma_dn - 0.5
    assert p.assisted_radius_rad > shipped_camera(name).camera.half_diagonal_rad
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
def test_impossible_parameters_are_refused(change: dict[str, object]) -> None:
    """Parameters that cannot work raise BadInput at once."""
    with pytest.raises(BadInput):
        replace(PARAMETERS, **change)  # type: ignore[arg-type]
