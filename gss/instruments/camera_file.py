"""``camera.yaml``: geometry, lens model, detector, limits and baffle of a camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from gss.domain.camera import Brown, BrownUndistort, Camera, Distortion, Pinhole, RadialTilt
from gss.domain.camera_profile import zero_point_e_s
from gss.domain.dark_columns import DarkColumns
from gss.domain.sensor import Baffle, Sensor
from gss.instruments.quantities import (
    Angle,
    Bits,
    Charge,
    Coefficient,
    Coefficients,
    Covered,
    Decay,
    Gain,
    Length,
    Level,
    Magnitude,
    Opening,
    Pitch,
    Pixels,
    Place,
    Quantity,
    Rate,
    Ratio,
    Seconds,
    Share,
    Sourced,
    Strict,
    Well,
    Width,
    ZeroPoint,
)

TYPICAL_TRANSMISSION = 0.8


class Geometry(Strict):
    """Geometry of detector and lens. Without a stated centre, the optical axis is at the middle of the detector. Pixel
    centres are at integer (column, row). ``dark_left``, ``dark_right``: numbers of columns that are shielded from light and
    are read out before and after ``columns``."""

    columns: Pixels
    rows: Pixels
    pitch_column: Pitch
    pitch_row: Pitch
    focal_length: Length
    f_number: Ratio
    centre_column: Place | None = None
    centre_row: Place | None = None
    dark_left: Covered | None = None
    dark_right: Covered | None = None

    @model_validator(mode="after")
    def _both_centres(self) -> Self:
        if (self.centre_column is None) != (self.centre_row is None):
            raise ValueError("state both centre_column and centre_row, or neither")
        return self


class PinholeLens(Sourced):
    """Model of a lens without distortion."""

    model: Literal["pinhole"]

    def distortion(self, focal_mm: float) -> Distortion:
        """Return the lens model. ``focal_mm``: focal length."""
        return Pinhole()


class BrownLens(Strict):
    """Brown's distortion polynomial, from ideal to measured coordinates."""

    model: Literal["brown"]
    k1: Coefficient
    k2: Coefficient
    p1: Coefficient
    p2: Coefficient
    k3: Coefficient | None = None

    def distortion(self, focal_mm: float) -> Distortion:
        """Return the lens model. ``focal_mm``: focal length."""
        return Brown(self.k1.value, self.k2.value, self.p1.value, self.p2.value, self.k3.value if self.k3 else 0.0)


class BrownUndistortLens(Strict):
    """Brown's distortion polynomial, from measured to ideal coordinates."""

    model: Literal["brown_undistort"]
    k1: Coefficient
    k2: Coefficient
    p1: Coefficient
    p2: Coefficient

    def distortion(self, focal_mm: float) -> Distortion:
        """Return the lens model. ``focal_mm``: focal length."""
        return BrownUndistort(self.k1.value, self.k2.value, self.p1.value, self.p2.value)


class RadialTiltLens(Strict):
    """Tilted detector and radial polynomial in millimetres (Jacobs 1995 eq. 6.13–6.16)."""

    model: Literal["radial_tilt"]
    tilt: Opening
    tilt_direction: Angle
    radial: Coefficients

    def distortion(self, focal_mm: float) -> Distortion:
        """Return the lens model. ``focal_mm``: focal length."""
        tilt, direction = np.radians(self.tilt.value), np.radians(self.tilt_direction.value)
        return RadialTilt(focal_mm, float(tilt), float(direction), self.radial.values)


Lens = Annotated[PinholeLens | BrownLens | BrownUndistortLens | RadialTiltLens, Field(discriminator="model")]


class Detector(Strict):
    """Conversion of light to digital numbers. The zero point (electrons per second from a star of V = 0) is either
    stated or computed from the pupil, ``transmission`` and ``quantum_efficiency``."""

    bits: Bits
    gain: Gain
    bias: Level
    full_well: Well
    read_noise: Charge
    dark_current: Rate
    background: Rate
    psf_sigma: Width
    transmission: Share | None = None
    quantum_efficiency: Share | None = None
    zero_point: ZeroPoint | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.zero_point is None) == (self.quantum_efficiency is None):
            raise ValueError("needs either zero_point or quantum_efficiency (with transmission)")
        if self.quantum_efficiency is not None and self.transmission is None:
            raise ValueError("quantum_efficiency needs transmission")
        if self.bias.value >= (1 << int(self.bits.value)) - 1:
            raise ValueError("the bias is at or above the largest value of the converter")
        return self


class CameraLimits(Strict):
    """Usable ranges of magnitude and exposure."""

    brightest: Magnitude
    faintest: Magnitude
    exposure_min: Seconds
    exposure_max: Seconds
    exposure: Seconds

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.brightest.value < self.faintest.value:
            raise ValueError("brightest must be a smaller magnitude than faintest")
        if not self.exposure_min.value <= self.exposure.value <= self.exposure_max.value:
            raise ValueError("exposure must lie between exposure_min and exposure_max")
        return self


class BaffleLimits(Strict):
    """Stray-light limits: angles from the boresight to the Sun's centre and to the Earth's limb."""

    sun: Opening
    earth: Opening
    blind: Opening
    decay: Decay
    stray_light: Rate


@dataclass(frozen=True)
class CameraNumber:
    """One number of the file, or several coefficients, with the origin stated in ``source`` or ``chosen``. ``sigma``:
    standard deviation, if known. A lens without distortion has no values."""

    part: str
    name: str
    values: tuple[float, ...]
    unit: str
    sigma: float | None
    source: str | None
    chosen: str | None


class CameraFile(Strict):
    """Content of ``camera.yaml``."""

    geometry: Geometry
    lens: Lens
    detector: Detector
    limits: CameraLimits
    baffle: BaffleLimits

    def camera(self) -> Camera:
        """Return the geometric camera model."""
        geometry = self.geometry
        columns, rows, focal_mm = int(geometry.columns.value), int(geometry.rows.value), geometry.focal_length.value
        lens = self.lens.distortion(focal_mm)
        if geometry.centre_column is None or geometry.centre_row is None:
            return Camera.from_optics(
                columns, rows, geometry.pitch_column.value, geometry.pitch_row.value, focal_mm, lens
            )
        focal_px = focal_mm / geometry.pitch_column.value, focal_mm / geometry.pitch_row.value
        return Camera(columns, rows, *focal_px, geometry.centre_column.value, geometry.centre_row.value, lens)

    def sensor(self) -> Sensor:
        """Return the photometric model."""
        detector, limits, geometry = self.detector, self.limits, self.geometry
        left, right = (int(q.value) if q else 0 for q in (geometry.dark_left, geometry.dark_right))
        return Sensor(
            bits=int(detector.bits.value),
            gain_e_per_dn=detector.gain.value,
            bias_dn=detector.bias.value,
            full_well_e=detector.full_well.value,
            read_noise_e=detector.read_noise.value,
            dark_current_e_s=detector.dark_current.value,
            background_e_s=detector.background.value,
            zero_point_e_s=self._zero_point_e_s(),
            psf_sigma_px=detector.psf_sigma.value,
            bright_limit_mag=limits.brightest.value,
            faint_limit_mag=limits.faintest.value,
            exposure_min_s=limits.exposure_min.value,
            exposure_max_s=limits.exposure_max.value,
            exposure_s=limits.exposure.value,
            dark_columns=DarkColumns(left, right),
        )

    def _zero_point_e_s(self) -> float:
        detector, geometry = self.detector, self.geometry
        if detector.zero_point is not None:
            return detector.zero_point.value
        efficiency = detector.quantum_efficiency.value if detector.quantum_efficiency else 0.0
        return zero_point_e_s(geometry.focal_length.value, geometry.f_number.value, self.transmission, efficiency)

    @property
    def transmission(self) -> float:
        """Return the transmission of the lens; a typical value if the file states none."""
        return self.detector.transmission.value if self.detector.transmission else TYPICAL_TRANSMISSION

    def stray_light(self) -> Baffle:
        """Return the limits of the baffle."""
        baffle = self.baffle
        sun, earth, blind, decay = (
            float(np.radians(a.value)) for a in (baffle.sun, baffle.earth, baffle.blind, baffle.decay)
        )
        return Baffle(sun, earth, blind, decay, baffle.stray_light.value)

    def numbers(self) -> tuple[CameraNumber, ...]:
        """Return all numbers in the order of the file."""
        numbers_read = []
        for part_name, part in self:
            if isinstance(part, PinholeLens):
                numbers_read.append(CameraNumber(part_name, part.model, (), "", None, part.source, part.chosen))
            for name, number in part:
                if isinstance(number, Quantity | Coefficients):
                    values, sigma = _values_of(number)
                    origin = number.source, number.chosen
                    numbers_read.append(CameraNumber(part_name, name, values, number.unit, sigma, *origin))
        return tuple(numbers_read)

    def sources(self) -> dict[str, str]:
        """Return the sources of the numbers; numbers with the same source share an entry."""
        titles: dict[str, list[str]] = {}
        for part in (self.geometry, self.lens, self.detector, self.limits, self.baffle):
            if isinstance(part, Sourced):
                titles.setdefault(part.origin, []).append("lens")
            for name, number in part:
                if isinstance(number, Sourced):
                    titles.setdefault(number.origin, []).append(name.replace("_", " "))
        return {", ".join(names): origin for origin, names in titles.items()}


def _values_of(number: Quantity | Coefficients) -> tuple[tuple[float, ...], float | None]:
    """Return the values of a number or of coefficients, and the standard deviation if it is known."""
    return ((number.value,), number.sigma) if isinstance(number, Quantity) else (number.values, None)
