"""One camera: geometry, photometry, and the source of each number."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gss.domain.camera import Camera
from gss.domain.sensor import Baffle, Defects, Sensor


@dataclass(frozen=True)
class CameraProfile:
    """All properties of one camera that the algorithms need.

    ``transmission``: transmission of the lens. ``chain``: name of the on-board chain that a unit with this camera runs.
    ``formats``: on-board catalogue formats that the unit reads, with its native format first. ``matching_formats``: the
    formats that contain all data needed for matching on board. ``sources``: source of each number, or the reason for its
    choice.
    """

    name: str
    title: str
    camera: Camera
    sensor: Sensor
    focal_mm: float
    pitch_col_mm: float
    pitch_row_mm: float
    f_number: float
    sources: dict[str, str]
    defects: Defects = field(default_factory=Defects)
    baffle: Baffle = field(default_factory=Baffle)
    transmission: float = 0.8
    chain: str = ""
    formats: tuple[str, ...] = ()
    matching_formats: tuple[str, ...] = ()

    @property
    def aperture_cm2(self) -> float:
        """Area of the entrance pupil in cm²."""
        return pupil_cm2(self.focal_mm, self.f_number)


def pupil_cm2(focal_mm: float, f_number: float) -> float:
    """Return the area of the entrance pupil in cm²."""
    return float(np.pi / 4 * (focal_mm / 10 / f_number) ** 2)


def zero_point_e_s(focal_mm: float, f_number: float, transmission: float, efficiency: float) -> float:
    """Return the electrons per second from a star of V = 0: 10³ photons/(s cm² Å) over 3000 Å (Erlank 2013 eq. 3.4.2),
    times lens transmission and quantum efficiency."""
    return pupil_cm2(focal_mm, f_number) * transmission * 3000 * 1e3 * efficiency
