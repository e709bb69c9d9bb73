"""An impossible table is rejected before it is sent, and on board again."""

from __future__ import annotations

import pytest

from gss.device.table_use import calibrated, calibration_values, check_parameters, parameter_values
from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_camera, shipped_registry


@pytest.mark.parametrize("name", sorted(i.name for i in shipped_registry().all() if i.profile.chain))
def test_a_units_default_values_are_accepted(name: str) -> None:
    """The unit's default values, which the form offers, are valid."""
    profile = shipped_camera(name)
    assert calibrated(profile, calibration_values(profile)).camera == profile.camera
    check_parameters(profile, parameter_values(profile))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("exposure_s", 1e308),
        ("gain_e_per_dn", 1e-308),
        ("dark_current_e_s", -1e9),
        ("background_e_s", 1e300),
        ("psf_sigma_px", 0.0),
        ("full_well_e", -1.0),
        ("exposure_s", 0.0),
        ("faint_limit_mag", -99.0),
        ("read_noise_e", -1.0),
        ("bias_dn", 1e9),
        ("focal_col_px", 1e-300),
        ("k1", 1e308),
        ("focal_col_px", "12"),
    ],
)
def test_an_impossible_calibration_is_rejected(field: str, value: float | str) -> None:
    """A calibration with an implausible value is rejected with the name of the value."""
    profile = shipped_camera("cubestar")
    with pytest.raises(BadInput, match=field):
        calibrated(profile, calibration_values(profile) | {field: value})


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("search_step_px", 0),
        ("threshold_dn", 1_000_000),
        ("window_px", 0),
        ("window_px", 100_000),
        ("max_centroids", 0),
        ("vote_margin", -1),
        ("min_verified_lost", 0),
        ("max_false_probability", 0.0),
        ("max_false_probability", 2.0),
        ("tracking_radius_rad", 100.0),
        ("edge_rule", 2),
    ],
)
def test_impossible_parameters_are_rejected(field: str, value: float) -> None:
    """A parameter set with an implausible constant is rejected with the name of the constant."""
    profile = shipped_camera("cubestar")
    with pytest.raises(BadInput, match=field):
        check_parameters(profile, parameter_values(profile) | {field: value})
