"""The shipped packages describe exactly the same cameras as the former constants of the program."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import pytest

from gss.instruments.registry import shipped_registry

EXPECTED: dict[str, dict[str, Any]] = {
    "sunsat": {
        "title": "Sunsat star sensor (Jacobs 1995)",
        "camera": {
            "columns": 752,
            "rows": 582,
            "focal_col_px": 3846.153846153846,
            "focal_row_px": 4000.0,
            "centre_col_px": 380.6538461538462,
            "centre_row_px": 310.3,
            "lens": [
                "RadialTilt",
                {
                    "focal_mm": 25.0,
                    "tilt_max_rad": 0.012793263417118436,
                    "tilt_direction_rad": 2.199114857512855,
                    "radial": [0.001, -8e-05, -0.00044],
                },
            ],
        },
        "sensor": {
            "bits": 8,
            "gain_e_per_dn": 35.0,
            "bias_dn": 10.0,
            "full_well_e": 30000.0,
            "read_noise_e": 40.0,
            "dark_current_e_s": 60.0,
            "background_e_s": 60.0,
            "zero_point_e_s": 1803210.0690247538,
            "psf_sigma_px": 1.2,
            "bright_limit_mag": 2.5,
            "faint_limit_mag": 6.0,
            "exposure_min_s": 0.02,
            "exposure_max_s": 1.0,
            "exposure_s": 0.5,
            "dark_columns": {"left": 3, "right": 40},
        },
        "focal_mm": 25.0,
        "pitch_col_mm": 0.0065,
        "pitch_row_mm": 0.00625,
        "f_number": 1.4,
        "defects": {
            "response_sigma": 0.01,
            "offset_sigma_dn": 0.2,
            "column_sigma_dn": 0.0,
            "dark_sigma": 0.3,
            "hot_share": 5e-05,
            "hot_e_s": 1500.0,
            "dead_share": 5e-06,
            "corner_loss": 0.2,
            "corner_blur_px": 0.0,
            "row_skew_ms": 0.0,
            "coupling_px": 57800.0,
        },
        "baffle": {
            "sun_limit_rad": 0.4904375198104066,
            "earth_limit_rad": 0.4904375198104066,
            "blind_rad": 0.20943951023931956,
            "decay_rad": 0.05235987755982989,
            "reference_e_s": 15.640624999999998,
        },
    },
    "cubestar": {
        "title": "CubeStar (Erlank 2013)",
        "camera": {
            "columns": 1024,
            "rows": 512,
            "focal_col_px": 1121.4285714285716,
            "focal_row_px": 1121.4285714285716,
            "centre_col_px": 511.5,
            "centre_row_px": 255.5,
            "lens": ["Brown", {"k1": -0.32358, "k2": 0.12456, "p1": 0.00414, "p2": -0.00624, "k3": 0.0}],
        },
        "sensor": {
            "bits": 8,
            "gain_e_per_dn": 5.0,
            "bias_dn": 8.0,
            "full_well_e": 5000.0,
            "read_noise_e": 6.0,
            "dark_current_e_s": 40.0,
            "background_e_s": 20.0,
            "zero_point_e_s": 193592.79329583704,
            "psf_sigma_px": 1.2,
            "bright_limit_mag": -1.5,
            "faint_limit_mag": 3.8,
            "exposure_min_s": 0.001,
            "exposure_max_s": 0.45,
            "exposure_s": 0.386,
            "dark_columns": {"left": 0, "right": 0},
        },
        "focal_mm": 6.28,
        "pitch_col_mm": 0.0056,
        "pitch_row_mm": 0.0056,
        "f_number": 1.2,
        "defects": {
            "response_sigma": 0.01,
            "offset_sigma_dn": 0.25,
            "column_sigma_dn": 0.3,
            "dark_sigma": 0.1,
            "hot_share": 0.0001,
            "hot_e_s": 2000.0,
            "dead_share": 2e-05,
            "corner_loss": 0.35,
            "corner_blur_px": 0.0,
            "row_skew_ms": 0.0,
            "coupling_px": 0.0,
        },
        "baffle": {
            "sun_limit_rad": 0.7853981633974483,
            "earth_limit_rad": 0.6981317007977318,
            "blind_rad": 0.6283185307179586,
            "decay_rad": 0.05235987755982989,
            "reference_e_s": 16.433511111111105,
        },
    },
    "far_mst": {
        "title": "FAR-MST / LIST (Huffman 2006)",
        "camera": {
            "columns": 1280,
            "rows": 1024,
            "focal_col_px": 2383.582089552239,
            "focal_row_px": 2383.582089552239,
            "centre_col_px": 639.5,
            "centre_row_px": 511.5,
            "lens": ["Brown", {"k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0, "k3": 0.0}],
        },
        "sensor": {
            "bits": 10,
            "gain_e_per_dn": 10.0,
            "bias_dn": 20.0,
            "full_well_e": 120000.0,
            "read_noise_e": 39.0,
            "dark_current_e_s": 410.0,
            "background_e_s": 50.0,
            "zero_point_e_s": 1486799.9999999995,
            "psf_sigma_px": 1.25,
            "bright_limit_mag": -1.5,
            "faint_limit_mag": 4.5,
            "exposure_min_s": 0.01,
            "exposure_max_s": 1.0,
            "exposure_s": 0.1,
            "dark_columns": {"left": 0, "right": 0},
        },
        "focal_mm": 15.97,
        "pitch_col_mm": 0.0067,
        "pitch_row_mm": 0.0067,
        "f_number": 1.0638079306358823,
        "defects": {
            "response_sigma": 0.01,
            "offset_sigma_dn": 0.7,
            "column_sigma_dn": 0.8,
            "dark_sigma": 0.1,
            "hot_share": 0.0001,
            "hot_e_s": 4000.0,
            "dead_share": 2e-05,
            "corner_loss": 0.2,
            "corner_blur_px": 0.0,
            "row_skew_ms": 0.0,
            "coupling_px": 0.0,
        },
        "baffle": {
            "sun_limit_rad": 0.6981317007977318,
            "earth_limit_rad": 0.5235987755982988,
            "blind_rad": 0.4188790204786391,
            "decay_rad": 0.05235987755982989,
            "reference_e_s": 29.9322910157121,
        },
    },
    "oersted": {
        "title": "Oersted star imager (Liebe 1992)",
        "camera": {
            "columns": 604,
            "rows": 576,
            "focal_col_px": 1094.0,
            "focal_row_px": 1402.5641025641025,
            "centre_col_px": 301.5,
            "centre_row_px": 287.5,
            "lens": ["Brown", {"k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0, "k3": 0.0}],
        },
        "sensor": {
            "bits": 8,
            "gain_e_per_dn": 120.0,
            "bias_dn": 10.0,
            "full_well_e": 60000.0,
            "read_noise_e": 60.0,
            "dark_current_e_s": 100.0,
            "background_e_s": 80.0,
            "zero_point_e_s": 1057491.8958239416,
            "psf_sigma_px": 1.0,
            "bright_limit_mag": -1.5,
            "faint_limit_mag": 4.96,
            "exposure_min_s": 0.05,
            "exposure_max_s": 2.0,
            "exposure_s": 0.8,
            "dark_columns": {"left": 0, "right": 0},
        },
        "focal_mm": 10.94,
        "pitch_col_mm": 0.01,
        "pitch_row_mm": 0.0078,
        "f_number": 0.8,
        "defects": {
            "response_sigma": 0.01,
            "offset_sigma_dn": 0.2,
            "column_sigma_dn": 0.0,
            "dark_sigma": 0.2,
            "hot_share": 5e-05,
            "hot_e_s": 1000.0,
            "dead_share": 5e-06,
            "corner_loss": 0.4,
            "corner_blur_px": 0.0,
            "row_skew_ms": 0.0,
            "coupling_px": 0.0,
        },
        "baffle": {
            "sun_limit_rad": 0.7853981633974483,
            "earth_limit_rad": 0.6108652381980153,
            "blind_rad": 0.4188790204786391,
            "decay_rad": 0.05235987755982989,
            "reference_e_s": 91.96687499999996,
        },
    },
    "aim": {
        "title": "AIM smart camera (Moniteq 1983)",
        "camera": {
            "columns": 256,
            "rows": 256,
            "focal_col_px": 4250.0,
            "focal_row_px": 4250.0,
            "centre_col_px": 127.5,
            "centre_row_px": 127.5,
            "lens": ["Brown", {"k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0, "k3": 0.0}],
        },
        "sensor": {
            "bits": 12,
            "gain_e_per_dn": 60.0,
            "bias_dn": 50.0,
            "full_well_e": 1300000.0,
            "read_noise_e": 73.0,
            "dark_current_e_s": 4000.0,
            "background_e_s": 100.0,
            "zero_point_e_s": 10908940.061581356,
            "psf_sigma_px": 0.45,
            "bright_limit_mag": 0.0,
            "faint_limit_mag": 6.5,
            "exposure_min_s": 0.01,
            "exposure_max_s": 10.0,
            "exposure_s": 2.0,
            "dark_columns": {"left": 0, "right": 0},
        },
        "focal_mm": 85.0,
        "pitch_col_mm": 0.02,
        "pitch_row_mm": 0.02,
        "f_number": 1.4,
        "defects": {
            "response_sigma": 0.005,
            "offset_sigma_dn": 1.0,
            "column_sigma_dn": 1.0,
            "dark_sigma": 0.015,
            "hot_share": 0.0001,
            "hot_e_s": 5000.0,
            "dead_share": 2e-05,
            "corner_loss": 0.1,
            "corner_blur_px": 0.0,
            "row_skew_ms": 0.0,
            "coupling_px": 0.0,
        },
        "baffle": {
            "sun_limit_rad": 0.3490658503988659,
            "earth_limit_rad": 0.3490658503988659,
            "blind_rad": 0.1308996938995747,
            "decay_rad": 0.05235987755982989,
            "reference_e_s": 154.0,
        },
    },
}


@pytest.mark.parametrize("name", sorted(EXPECTED))
def test_a_shipped_camera_has_the_same_numbers(name: str) -> None:
    """Geometry, photometry, defects and baffle equal the literal values exactly."""
    profile = shipped_registry().camera(name)
    values = asdict(profile)
    lens = values["camera"].pop("distortion")
    values["camera"]["lens"] = [type(profile.camera.distortion).__name__, {**lens, **_lists(lens)}]
    assert {key: values[key] for key in EXPECTED[name]} == EXPECTED[name]
    assert profile.name == name
    assert all(profile.sources.values())


def _lists(lens: dict[str, Any]) -> dict[str, Any]:
    return {key: list(value) for key, value in lens.items() if isinstance(value, tuple)}


OF_OTHER_MAKERS = {"nos3", "oresat", "sagitta"}


def test_the_shipped_instruments_are_those_of_the_documents_and_of_other_makers() -> None:
    """The shipped instruments are exactly these, all are valid with different versions, and those of the documents share
    one dictionary."""
    registry = shipped_registry()
    assert set(registry.names()) == set(EXPECTED) | OF_OTHER_MAKERS
    assert registry.broken() == ()
    assert len({registry.get(name).dictionary.hash for name in EXPECTED}) == 1
    assert len({i.version for i in registry.all()}) == len(registry.names())
