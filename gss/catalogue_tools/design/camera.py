"""Camera design: its editable parameters, their validation, and the conversion to geometry and photometry."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from gss.catalogue_tools.envelope.field import FieldShape
from gss.domain.camera import Brown, Camera
from gss.domain.camera_profile import CameraProfile, pupil_cm2
from gss.domain.errors import BadInput
from gss.domain.sensor import Sensor

V0_PHOTONS_S_CM2_NM = 1e4
"""Photon flux from V = 0: 10³ photons per second, cm² and Å (Erlank 2013 eq. 3.4.2, φ = 10^((15 − 2M)/5))."""
BANDWIDTH_NM = 300.0
THRESHOLD_SNR = 5.0
# Smallest and largest accepted values with their unit. Values outside these ranges give meaningless results.
LIMITS: dict[str, tuple[float, float, str]] = {
    "columns": (16, 16384, "px"),
    "rows": (16, 16384, "px"),
    "pitch_col_um": (0.5, 100.0, "µm"),
    "pitch_row_um": (0.5, 100.0, "µm"),
    "focal_mm": (1.0, 2000.0, "mm"),
    "f_number": (0.4, 32.0, ""),
    "transmission": (0.01, 1.0, ""),
    "efficiency": (0.01, 1.0, ""),
    "bandwidth_nm": (10.0, 1000.0, "nm"),
    "exposure_s": (1e-4, 60.0, "s"),
    "psf_sigma_px": (0.2, 10.0, "px"),
    "bits": (4, 16, ""),
    "gain_e_per_dn": (0.01, 10_000.0, "e/DN"),
    "bias_dn": (0.0, 65_535.0, "DN"),
    "full_well_e": (100.0, 1e8, "e"),
    "read_noise_e": (0.0, 10_000.0, "e"),
    "dark_current_e_s": (0.0, 1e7, "e/s"),
    "background_e_s": (0.0, 1e7, "e/s"),
    "response_sigma": (0.0, 0.5, ""),
    "threshold_snr": (0.5, 100.0, ""),
}
WHOLE_NUMBERS = ("columns", "rows", "bits")
MAX_DIAGONAL_RAD = float(np.radians(160.0))


@dataclass(frozen=True)
class DesignCamera:
    """Parameters of one camera. The lens has no distortion, and the optical axis is in the middle of the detector.

    ``efficiency``: electrons per photon at the detector, including the fill factor. ``bandwidth_nm``: bandwidth of the
    detected light. ``background_e_s``: sky and stray light per pixel. ``response_sigma``: spread of the pixels'
    relative response. ``threshold_snr``: signal-to-noise ratio at which a star is detected. ``mag_limit``: faintest
    magnitude V used; None: the radiometric limit.
    """

    name: str
    columns: int
    rows: int
    pitch_col_um: float
    pitch_row_um: float
    focal_mm: float
    f_number: float
    transmission: float
    efficiency: float
    exposure_s: float
    psf_sigma_px: float
    bits: int
    gain_e_per_dn: float
    bias_dn: float
    full_well_e: float
    read_noise_e: float
    dark_current_e_s: float
    background_e_s: float
    response_sigma: float
    bandwidth_nm: float = BANDWIDTH_NM
    threshold_snr: float = THRESHOLD_SNR
    mag_limit: float | None = None

    def __post_init__(self) -> None:
        for name, (low, high, unit) in LIMITS.items():
            value = getattr(self, name)
            if not (np.isfinite(value) and low <= value <= high):
                raise BadInput(
                    f"{name} is out of range", expected=f"{low:g} to {high:g} {unit}".rstrip(), got=f"{value:g} {unit}"
                )
            if name in WHOLE_NUMBERS and value != int(value):
                raise BadInput(f"{name} is not a whole number", expected="a whole number", got=f"{value:g}")
        if self.mag_limit is not None and not -1.4 <= self.mag_limit <= 12.0:
            raise BadInput(
                "the limiting magnitude is out of range",
                expected="V −1.4 to 12",
                got=f"{self.mag_limit:g}",
                hint="leave it empty to use the limit from radiometry",
            )
        if self.bias_dn >= (1 << self.bits) - 1:
            raise BadInput(
                "the bias fills the range of the converter",
                expected=f"a bias below {(1 << self.bits) - 1} DN ({self.bits} bits)",
                got=f"{self.bias_dn:g} DN",
            )
        if 2 * self.half_diagonal_rad > MAX_DIAGONAL_RAD:
            raise BadInput(
                "the field is too wide for a flat detector",
                expected=f"a diagonal of at most {np.degrees(MAX_DIAGONAL_RAD):g}°",
                got=f"{np.degrees(2 * self.half_diagonal_rad):.1f}°",
                hint="use a longer focal length or a smaller detector",
            )

    @classmethod
    def from_profile(cls, profile: CameraProfile) -> DesignCamera:
        """Return a design with the parameters of a camera profile. The efficiency is computed from the zero point."""
        geometry, sensor = profile.camera, profile.sensor
        photons_s = profile.aperture_cm2 * profile.transmission * BANDWIDTH_NM * V0_PHOTONS_S_CM2_NM
        return cls(
            profile.name,
            geometry.columns,
            geometry.rows,
            profile.pitch_col_mm * 1e3,
            profile.pitch_row_mm * 1e3,
            profile.focal_mm,
            profile.f_number,
            profile.transmission,
            sensor.zero_point_e_s / photons_s,
            sensor.exposure_s,
            sensor.psf_sigma_px,
            sensor.bits,
            sensor.gain_e_per_dn,
            sensor.bias_dn,
            sensor.full_well_e,
            sensor.read_noise_e,
            sensor.dark_current_e_s,
            sensor.background_e_s,
            profile.defects.response_sigma,
        )

    @cached_property
    def camera(self) -> Camera:
        """Geometry of the camera."""
        pitch_mm = self.pitch_col_um / 1e3, self.pitch_row_um / 1e3
        return Camera.from_optics(self.columns, self.rows, *pitch_mm, self.focal_mm, Brown())

    @cached_property
    def shape(self) -> FieldShape:
        """The field of view."""
        return FieldShape(self.camera)

    @property
    def half_size_mm(self) -> tuple[float, float]:
        """Half the size of the detector, along columns and along rows."""
        return self.columns * self.pitch_col_um / 2e3, self.rows * self.pitch_row_um / 2e3

    @property
    def half_diagonal_rad(self) -> float:
        """Angle from the boresight to a corner."""
        return float(np.arctan(np.hypot(*self.half_size_mm) / self.focal_mm))

    @property
    def fov_rad(self) -> tuple[float, float]:
        """Full field of view across columns and across rows: 2·atan(I/2f) with the detector size I and
        the focal length f (Erlank 2013 §3.5.5, with the factor ½ that Table 3.5 uses)."""
        x, y = self.half_size_mm
        return 2 * float(np.arctan(x / self.focal_mm)), 2 * float(np.arctan(y / self.focal_mm))

    @property
    def pupil_mm(self) -> float:
        """Diameter of the entrance pupil."""
        return self.focal_mm / self.f_number

    @property
    def aperture_cm2(self) -> float:
        """Area of the entrance pupil."""
        return pupil_cm2(self.focal_mm, self.f_number)

    @property
    def zero_point_e_s(self) -> float:
        """Electrons per second from a star of V = 0 (Erlank 2013 eq. 3.4.2 times the efficiency)."""
        photons_s = self.aperture_cm2 * self.transmission * self.bandwidth_nm * V0_PHOTONS_S_CM2_NM
        return photons_s * self.efficiency

    @property
    def sensor(self) -> Sensor:
        """Photometric model. The exposure range contains only the exposure of the design. The magnitude limits are so
        wide that they do not exclude stars."""
        return Sensor(
            self.bits,
            self.gain_e_per_dn,
            self.bias_dn,
            self.full_well_e,
            self.read_noise_e,
            self.dark_current_e_s,
            self.background_e_s,
            self.zero_point_e_s,
            self.psf_sigma_px,
            -2.0,
            12.0,
            self.exposure_s,
            self.exposure_s,
            self.exposure_s,
        )

    @property
    def noise_e(self) -> float:
        """Standard deviation of a dark-sky pixel."""
        return self.sensor.noise_e(self.exposure_s)

    @property
    def brightest_pixel_e(self) -> float:
        """Largest star signal in electrons that a pixel can measure before the full well or the converter saturates."""
        background_e = (self.dark_current_e_s + self.background_e_s) * self.exposure_s
        converter_e = (self.sensor.saturation_dn - self.bias_dn) * self.gain_e_per_dn
        return max(0.0, min(self.full_well_e, converter_e) - background_e)

    def edited(self, **changes: object) -> DesignCamera:
        """Return the camera with changed values. None leaves a value unchanged. Raises BadInput for unknown names and
        invalid values."""
        field_names = {f.name for f in fields(self)}
        for name in changes:
            if name not in field_names:
                raise BadInput("unknown camera parameter", expected=" | ".join(sorted(field_names)), got=name)
        return replace(self, **{k: v for k, v in changes.items() if v is not None})  # type: ignore[arg-type]  # names are fields

    def fields_different_from(self, other: DesignCamera) -> tuple[str, ...]:
        """Return the names of the fields that differ from ``other``."""
        return tuple(f.name for f in fields(self) if getattr(self, f.name) != getattr(other, f.name))
