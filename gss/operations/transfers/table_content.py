"""Pure functions that convert the content of a table between editable values and bytes for the sensor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.formats.triplet_table import HEADER_VERSION as TRIPLET_FORMAT
from gss.catalogue_tools.formats.triplet_table import decode_triplets, encode_triplets, figures, triplets_of
from gss.catalogue_tools.onboard import decode as decode_bank
from gss.catalogue_tools.onboard import read_header
from gss.device.table_use import (
    MODELS,
    calibrated,
    calibration_values,
    check_bad_pixels,
    check_parameters,
    parameter_values,
)
from gss.device.tables import (
    BAD_PIXELS,
    TABLE_FORMAT,
    Scalar,
    decode_bad_pixels,
    decode_table,
    encode_bad_pixels,
    encode_table,
)
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.stars import StarTable
from gss.skytables.triplets import TripletClasses, faintest_mag

CHAIN_KINDS = ("calibration", "parameters")
KINDS = (*CHAIN_KINDS, "triplets", BAD_PIXELS)
TRIPLET_LIMITS = {
    "uncertainty_arcsec": (1.0, 3600.0),
    "limit_mag": (0.0, 10.0),
    "max_deg": (0.5, 45.0),
    "brightness_error": (0.0, 0.9),
}
BRIGHTNESS_ERROR = 0.25
FORMATS = {
    "calibration": TABLE_FORMAT,
    "parameters": TABLE_FORMAT,
    "triplets": TRIPLET_FORMAT,
    BAD_PIXELS: TABLE_FORMAT,
}


def defaults(kind: str, profile: CameraProfile) -> dict[str, Scalar]:
    """Return the initial values of a new table. Raises BadInput for an unknown kind."""
    if kind == "calibration":
        return calibration_values(profile)
    if kind == "parameters":
        return parameter_values(profile)
    if kind == "triplets":
        return _triplet_defaults(profile)
    if kind == BAD_PIXELS:
        return {"pixels": ""}
    raise BadInput("unknown kind of table", expected=" | ".join(KINDS), got=kind)


def _triplet_defaults(profile: CameraProfile) -> dict[str, Scalar]:
    """Return the default values: tolerances of 3′ and 25 % (Liebe), neighbours within half the field of view, and the
    faintest magnitude for which a star list that is complete to the camera's limit is sufficient."""
    deepest_mag = profile.sensor.faint_limit_mag + 2.5 * math.log10(1 - BRIGHTNESS_ERROR)
    return {
        "uncertainty_arcsec": 180.0,
        "limit_mag": round(deepest_mag - 0.05, 1),
        "max_deg": round(math.degrees(min(profile.camera.fov_rad)) / 2, 1),
        "brightness_error": BRIGHTNESS_ERROR,
    }


def table_bytes(kind: str, profile: CameraProfile, changes: Mapping[str, Any]) -> tuple[bytes, dict[str, Scalar]]:
    """Return bytes and values of a calibration, parameter set or bad-pixel table, which has the default values with
    ``changes``. Raises BadInput with the name of the invalid value."""
    values = _changed(kind, defaults(kind, profile), changes)
    if kind == BAD_PIXELS:
        return _bad_pixel_bytes(profile, values)
    if kind == "calibration":
        calibrated(profile, values)
    else:
        check_parameters(profile, values)
    return encode_table(kind, profile.name, values), values


def _bad_pixel_bytes(profile: CameraProfile, values: Mapping[str, Scalar]) -> tuple[bytes, dict[str, Scalar]]:
    unknown = set(values) - {"pixels"}
    if unknown:
        raise BadInput("unknown value", expected="pixels", got=", ".join(sorted(unknown)))
    cells = [text.split(",") for text in str(values["pixels"]).split()]
    wrong = [",".join(c) for c in cells if len(c) != 2 or not all(n.isdecimal() and len(n) <= 5 for n in c)]
    if wrong:
        raise BadInput(
            "a bad pixel cannot be read", expected="column,row, with spaces between the pixels", got=wrong[0]
        )
    pixels = np.array([[int(n) for n in c] for c in cells], np.intp).reshape(-1, 2)
    check_bad_pixels(profile, pixels)
    data = encode_bad_pixels(profile.name, pixels)
    return data, {"pixels": pixel_text(decode_bad_pixels(data)[1])}


def pixel_text(pixels: NDArray[np.integer]) -> str:
    """Return (k, 2) columns and rows as text, the form in which the content of a bad-pixel table is edited."""
    return " ".join(f"{col},{row}" for col, row in pixels.tolist())


def _changed(kind: str, values: dict[str, Scalar], changes: Mapping[str, Any]) -> dict[str, Scalar]:
    # If the distortion model or the chain differs from the default, the default values do not apply, and the user must
    # state all values.
    selector = {"calibration": "distortion", "parameters": "chain"}.get(kind, "")
    if selector in changes and changes[selector] != values[selector]:
        values = {} if kind == "parameters" else {k: v for k, v in values.items() if k not in _model_values()}
    return values | dict(changes)


def _model_values() -> set[str]:
    """Return the names of the values that depend on the distortion model."""
    return {name for _, names in MODELS.values() for name in names}


def triplet_bytes(
    stars: StarTable, profile: CameraProfile, image: bytes, changes: Mapping[str, Any]
) -> tuple[bytes, dict[str, Scalar]]:
    """Return the bytes and statistics of the triplet table for a bank image. ``stars``: star list of the image. If it ends
    (``list_ends_mag``) before ``complete_to_mag``, the table lacks triplets with stars that are detected only sometimes. Raises
    BadInput."""
    parameters = _triplet_defaults(profile) | dict(changes)
    unknown = set(parameters) - set(TRIPLET_LIMITS)
    if unknown:
        raise BadInput("unknown value", expected=", ".join(TRIPLET_LIMITS), got=", ".join(sorted(unknown)))
    numbers = {name: _within(name, parameters[name]) for name in TRIPLET_LIMITS}
    table = triplets_of(
        stars,
        TripletClasses.of(math.radians(numbers["uncertainty_arcsec"] / 3600)),
        numbers["limit_mag"],
        math.radians(numbers["max_deg"]),
        brightness_error=numbers["brightness_error"],
    )
    data = encode_triplets(table, read_header(image).body_crc32)
    completeness: dict[str, Scalar] = {
        "list_ends_mag": float(stars.v_mag.max()),
        "complete_to_mag": faintest_mag(numbers["limit_mag"], numbers["brightness_error"]),
    }
    return data, {**numbers, **_triplet_figures(data), **completeness}


def _within(name: str, value: object) -> float:
    low, high = TRIPLET_LIMITS[name]
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise BadInput(f"{name} is out of range", expected=f"{low:g} – {high:g}", got=str(value))
    return float(value)


def _triplet_figures(data: bytes) -> dict[str, Scalar]:
    triplets = figures(decode_triplets(data))
    scalars: dict[str, Scalar] = {
        "stars": triplets.stars,
        "references": triplets.references,
        "per_star": triplets.per_star,
    }
    return scalars | ({"stars_per_key": triplets.stars_per_key} if math.isfinite(triplets.stars_per_key) else {})


def read_back(kind: str, data: bytes) -> tuple[str, int, dict[str, Scalar]]:
    """Return profile, format and values of a table received from a device; the profile is "" if the bytes do not
    contain it. Raises CorruptData or BadInput for an invalid table."""
    if kind in CHAIN_KINDS:
        profile_name, values = decode_table(kind, data)
        return profile_name, TABLE_FORMAT, values
    if kind == BAD_PIXELS:
        profile_name, pixels = decode_bad_pixels(data)
        return profile_name, TABLE_FORMAT, {"pixels": pixel_text(pixels)}
    if kind == "triplets":
        return "", TRIPLET_FORMAT, _triplet_figures(data)
    return "", 0, {"bytes": len(data)}


def star_list(image: bytes, stars: StarTable, hips: list[int]) -> StarTable:
    """Return the stars of a bank image in row order, with the bank's positions and the ground's magnitudes. Raises
    BadInput if a star is not in the ground's catalogue."""
    bank = decode_bank(image)
    unknown = [hip for hip in hips if hip not in stars.row_of_hip]
    if unknown or len(hips) != len(bank):
        raise BadInput("some stars of this catalogue are not in the ground's catalogue", got=f"{len(unknown)} unknown")
    chosen = stars.take(np.array([stars.row_of_hip[hip] for hip in hips], np.intp))
    return replace(chosen, icrs=np.asarray(bank.icrs, float))
