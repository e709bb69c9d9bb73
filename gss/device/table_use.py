"""Apply calibration and parameter tables to the camera model and the constants of the on-board chain."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.device.tables import Scalar
from gss.domain.camera import Brown, BrownUndistort, Camera, Distortion, Pinhole, RadialTilt
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput, NotFound
from gss.domain.sensor import Sensor
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.onboard import Commanded, OnboardChain
from gss.pipeline.chains.systems import SYSTEMS, on_board, system

GEOMETRY = ("columns", "rows", "focal_col_px", "focal_row_px", "centre_col_px", "centre_row_px")
WHOLE = ("columns", "rows", "bits")
PHOTOMETRY = tuple(f.name for f in fields(Sensor) if f.name != "dark_columns")
RADIAL = ("radial_1", "radial_2", "radial_3", "radial_4")
COMMANDED = ("threshold_dn", "min_area_px", "max_area_px")
"""Constants that SET_DETECTION sets; activating a parameter set replaces their values."""
REASON = 100.0
LOST_NOTHING: Mapping[str, Scalar] = {}


def _radial_tilt(values: Mapping[str, float]) -> RadialTilt:
    given = [k for k, name in enumerate(RADIAL, 1) if name in values]
    radial = tuple(values.get(name, 0.0) for name in RADIAL[: max(given, default=0)])
    return RadialTilt(values["focal_mm"], values["tilt_max_rad"], values["tilt_direction_rad"], radial)


MODELS: dict[str, tuple[Callable[[Mapping[str, float]], Distortion], tuple[str, ...]]] = {
    "pinhole": (lambda _: Pinhole(), ()),
    "brown": (lambda v: Brown(**v), ("k1", "k2", "p1", "p2", "k3")),
    "brown_undistort": (lambda v: BrownUndistort(**v), ("k1", "k2", "p1", "p2")),
    "radial_tilt": (_radial_tilt, ("focal_mm", "tilt_max_rad", "tilt_direction_rad", *RADIAL)),
}
NAMES = {Pinhole: "pinhole", Brown: "brown", BrownUndistort: "brown_undistort", RadialTilt: "radial_tilt"}


def calibration_values(profile: CameraProfile) -> dict[str, Scalar]:
    """Return the geometry and photometry of a camera as the values of a calibration table."""
    camera, model = profile.camera, profile.camera.distortion
    values: dict[str, Scalar] = {"distortion": NAMES[type(model)]}
    values |= {name: getattr(camera, name) for name in GEOMETRY}
    if isinstance(model, RadialTilt):
        values |= {n: getattr(model, n) for n in ("focal_mm", "tilt_max_rad", "tilt_direction_rad")}
        values |= dict(zip(RADIAL, model.radial, strict=False))
    else:
        values |= {n: float(getattr(model, n)) for n in MODELS[NAMES[type(model)]][1]}
    return values | {name: getattr(profile.sensor, name) for name in PHOTOMETRY}


def calibrated(profile: CameraProfile, values: Mapping[str, Scalar]) -> CameraProfile:
    """Return the profile with the geometry and photometry of a table. Raises BadInput if the values do not fit this
    detector."""
    word = str(values.get("distortion"))
    if word not in MODELS:
        raise BadInput("unknown distortion model", expected=" | ".join(MODELS), got=word)
    make, coefficients = MODELS[word]
    unknown = set(values) - {"distortion", *GEOMETRY, *coefficients, *PHOTOMETRY}
    optional = {*coefficients, *RADIAL} - {"focal_mm", "tilt_max_rad", "tilt_direction_rad"}
    missing = {*GEOMETRY, *coefficients, *PHOTOMETRY} - optional - set(values)
    if unknown or missing:
        wrong = ", ".join(sorted(unknown | missing))
        raise BadInput(
            "the calibration has missing or unknown values", expected="geometry, coefficients, photometry", got=wrong
        )
    text_names = [n for n, v in values.items() if isinstance(v, str) and n != "distortion"]
    if text_names:
        raise BadInput("a value of the calibration is not a number", expected="a number", got=", ".join(text_names))
    numbers = {n: float(v) for n, v in values.items() if not isinstance(v, str)}
    integers = {n: int(numbers[n]) for n in WHOLE}
    size = profile.camera.columns, profile.camera.rows, profile.sensor.bits
    if tuple(integers.values()) != size or any(numbers[n] != integers[n] for n in WHOLE):
        got = "{columns} x {rows} px, {bits} bits".format(**integers)
        raise BadInput(
            "the calibration is for another detector", expected=f"{size[0]} x {size[1]} px, {size[2]} bits", got=got
        )
    if numbers["focal_col_px"] <= 0 or numbers["focal_row_px"] <= 0 or numbers["gain_e_per_dn"] <= 0:
        raise BadInput("a focal length or the gain is not greater than zero")
    instrument_values = calibration_values(profile)
    for name in numbers:
        current = instrument_values.get(name, profile.focal_mm if name == "focal_mm" else 0.0)
        # The true value of a lens coefficient can be zero or have the opposite sign.
        within_reason(
            name, numbers[name], -abs(float(current)) if name in coefficients and name != "focal_mm" else current
        )
    if not numbers["bright_limit_mag"] < numbers["faint_limit_mag"]:
        raise BadInput(
            "the bright limit is not brighter than the faint limit", expected="bright_limit_mag below faint_limit_mag"
        )
    distortion = make({n: numbers[n] for n in coefficients if n in numbers})
    geometry = {n: numbers[n] for n in GEOMETRY if n not in WHOLE}
    camera = Camera(columns=integers["columns"], rows=integers["rows"], **geometry, distortion=distortion)
    photometry = {n: numbers[n] for n in PHOTOMETRY if n not in WHOLE}
    sensor = Sensor(bits=integers["bits"], dark_columns=profile.sensor.dark_columns, **photometry)
    return replace(profile, camera=camera, sensor=sensor)


def check_bad_pixels(profile: CameraProfile, pixels: NDArray[np.integer]) -> None:
    """Raise BadInput if one of the (k, 2) columns and rows is not on the detector."""
    columns, rows = profile.camera.columns, profile.camera.rows
    outside = pixels[((pixels < 0) | (pixels >= (columns, rows))).any(axis=1)]
    if len(outside):
        got = f"column {outside[0, 0]}, row {outside[0, 1]}"
        raise BadInput("a bad pixel is not on the detector", expected=f"{columns} x {rows} px", got=got)


def within_reason(name: str, value: float, reference: Scalar) -> None:
    """Raise BadInput if a value is implausibly far from the unit's default value.

    Limits: from 1/100 to 100 times the default value. If the default value is zero or negative: ± 100 times its
    absolute value, at least ± 10.
    """
    if isinstance(reference, str):
        return
    if float(reference) > 0:
        low, high = float(reference) / REASON, float(reference) * REASON
    else:
        low, high = -max(10.0, REASON * abs(float(reference))), max(10.0, REASON * abs(float(reference)))
    if not low <= value <= high:
        raise BadInput(
            f"{name} is implausible", expected=f"{low:g} – {high:g}, default {reference:g}", got=f"{value:g}"
        )


RETIRED = ("rate_interval_s",)
"""Constants of tables from before version 0.5 that no chain uses now. Tables that contain them are still valid."""


def constants(parameters: Any) -> dict[str, float | int | bool]:
    """Return the numeric parameters of a chain by name."""
    return {f.name: v for f in fields(parameters) if isinstance(v := getattr(parameters, f.name), float | int | bool)}


def parameter_values(profile: CameraProfile, chain: OnboardChain | None = None) -> dict[str, Scalar]:
    """Return a unit's chain and its constants as the values of a parameter table.

    Constants derived from the camera or the exposure are omitted, because a table would fix their values.
    """
    used = chain or on_board(profile)
    parameters = used.parameters(profile, None, Commanded(), Mode.LOST_IN_SPACE)
    longer = constants(used.parameters(profile, 2 * profile.sensor.exposure_s, Commanded(), Mode.LOST_IN_SPACE))
    plain = {f.name for f in fields(parameters) if f.default is not MISSING}
    fixed = {n: v for n, v in constants(parameters).items() if n in plain and longer.get(n) == v}
    return {"chain": used.name} | fixed | {n: v for n, v in constants(parameters).items() if n in COMMANDED}


def chain_of(profile: CameraProfile, values: Mapping[str, Scalar] = LOST_NOTHING) -> OnboardChain:
    """Return the chain of a parameter table; without a table, the unit's default chain."""
    return system(str(values["chain"])) if values else on_board(profile)


def check_parameters(profile: CameraProfile, values: Mapping[str, Scalar]) -> None:
    """Raise BadInput if a parameter set has an unknown chain or constant, or a value of the wrong type."""
    try:
        chain = chain_of(profile, values)
    except NotFound as error:
        raise BadInput(error.message, expected=" | ".join(SYSTEMS), got=error.got) from None
    _replaced(chain.parameters(profile, None, Commanded(), Mode.LOST_IN_SPACE), values, ())


def parameters_with(
    values: Mapping[str, Scalar], profile: CameraProfile, exposure_s: float | None, commanded: Commanded, mode: Mode
) -> Any:
    """Return a chain's parameters for one frame: the defaults, overridden by the table's values, then by commanded
    values."""
    chain = chain_of(profile, values)
    plain = chain.parameters(profile, exposure_s, Commanded(), mode)
    parameters = chain.parameters(profile, exposure_s, commanded, mode)
    if not values:
        return parameters
    # For all other constants that a command changes, such as the radius of a hint, the commanded value also takes
    # precedence.
    changed = [n for n, v in constants(parameters).items() if constants(plain).get(n) != v]
    set_by_command = [n for n in COMMANDED if getattr(commanded, n) is not None]
    return _replaced(parameters, values, (*set_by_command, *changed))


def _replaced(parameters: Any, values: Mapping[str, Scalar], protected: tuple[str, ...] | list[str]) -> Any:
    present = constants(parameters)
    new: dict[str, object] = {}
    for name, value in values.items():
        if name == "chain" or name in RETIRED:
            continue
        if name not in present:
            raise BadInput("the chain has no such constant", expected=", ".join(sorted(present)), got=name)
        kind = type(present[name])
        if isinstance(value, str) or (kind is not float and float(value) != int(value)):
            raise BadInput(f"{name} has the wrong type", expected=kind.__name__, got=str(value))
        if kind is bool and value not in (0, 1):
            raise BadInput(f"{name} is a boolean", expected="0 or 1", got=str(value))
        if kind is not bool:
            within_reason(name, float(value), present[name])
        if name not in protected:
            new[name] = kind(value)
    return replace(parameters, **new)
