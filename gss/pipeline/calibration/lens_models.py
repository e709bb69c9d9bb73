"""Cameras as parameter vectors: the parameters of each lens model, and conversion between vector and camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Brown, Camera, Distortion, Pinhole, RadialTilt

GEOMETRY = ("focal_px", "aspect", "centre_col_px", "centre_row_px")
BROWN = ("k1", "k2", "p1", "p2", "k3")
TILT = ("tilt_col_rad", "tilt_row_rad")
RADIAL = ("radial_1", "radial_2", "radial_3", "radial_4")
LENS_MODELS: dict[str, tuple[str, ...]] = {
    "pinhole": (),
    "brown-2": ("k1", "k2"),
    "brown-4": ("k1", "k2", "p1", "p2"),
    "brown-5": ("k1", "k2", "p1", "p2", "k3"),
    # radial_1 is equivalent to the focal length, so it is not fitted.
    "radial-tilt": ("tilt_col_rad", "tilt_row_rad", "radial_2", "radial_3"),
}
# Order in which parameters are fixed if the stars cannot separate them.
FREEZING_ORDER = (
    ("k3",),
    ("radial_3",),
    TILT,
    ("p1", "p2"),
    ("k2",),
    ("radial_2",),
    ("centre_col_px", "centre_row_px"),
    ("aspect",),
    ("k1",),
    ("focal_px",),
)
UNITS = {"focal_px": "px", "centre_col_px": "px", "centre_row_px": "px"} | dict.fromkeys(TILT, "rad")


@dataclass(frozen=True)
class Vector:
    """Parameters of a camera with one lens model, by name. ``free``: names of the fitted parameters. ``focal_mm``:
    scale of the polynomial in millimetres; it does not affect other parameters."""

    model: str
    columns: int
    rows: int
    values: Mapping[str, float]
    free: tuple[str, ...]
    focal_mm: float = float("nan")

    def moved(self, step: Array) -> Vector:
        """Return the vector with ``step`` added to the free parameters. Focal length and aspect are multiplied by exp(step)."""
        values = dict(self.values)
        for name, by in zip(self.free, step.tolist(), strict=True):
            values[name] = values[name] * float(np.exp(by)) if name in ("focal_px", "aspect") else values[name] + by
        return replace(self, values=values)

    def without(self, names: tuple[str, ...]) -> Vector:
        """Return the vector with these parameters fixed."""
        return replace(self, free=tuple(n for n in self.free if n not in names))

    def value(self) -> Array:
        """Return the (p,) free parameters as ``moved`` uses them: focal length and aspect as logarithms."""
        return np.array([self._inside(n) for n in self.free])

    def _inside(self, name: str) -> float:
        v = self.values[name]
        return float(np.log(v)) if name in ("focal_px", "aspect") else v

    def camera(self) -> Camera:
        """Return the camera with these parameters."""
        v = self.values
        root = float(np.sqrt(v["aspect"]))
        focal = v["focal_px"]
        centre = v["centre_col_px"], v["centre_row_px"]
        return Camera(self.columns, self.rows, focal * root, focal / root, *centre, self._lens())

    def _lens(self) -> Distortion:
        v = self.values
        if self.model == "pinhole":
            return Pinhole()
        if self.model == "radial-tilt":
            tilt = float(np.hypot(v[TILT[0]], v[TILT[1]]))
            direction = float(np.arctan2(v[TILT[1]], v[TILT[0]]))
            radial = tuple(v[n] for n in RADIAL)
            return RadialTilt(self.focal_mm, tilt, direction, radial[:3] if radial[3] == 0.0 else radial)
        return Brown(*(v.get(n, 0.0) for n in BROWN))


def vector_of(camera: Camera, model: str, focal_mm: float = float("nan")) -> Vector:
    """Return the initial vector: the geometry of the camera, and the lens coefficients of the camera that are also in
    the model."""
    lens = camera.distortion
    focal = float(np.sqrt(camera.focal_col_px * camera.focal_row_px))
    values = {
        "focal_px": focal,
        "aspect": camera.focal_col_px / camera.focal_row_px,
        "centre_col_px": camera.centre_col_px,
        "centre_row_px": camera.centre_row_px,
    }
    if model == "radial-tilt":
        values |= dict.fromkeys((*TILT, *RADIAL), 0.0)
        if isinstance(lens, RadialTilt):
            focal_mm = lens.focal_mm
            values[TILT[0]] = lens.tilt_max_rad * float(np.cos(lens.tilt_direction_rad))
            values[TILT[1]] = lens.tilt_max_rad * float(np.sin(lens.tilt_direction_rad))
            values |= dict(zip(RADIAL, lens.radial, strict=False))
    elif model != "pinhole":
        coefficients = {n: getattr(lens, n) for n in BROWN} if isinstance(lens, Brown) else {}
        values |= {n: coefficients.get(n, 0.0) for n in LENS_MODELS[model]}
    return Vector(model, camera.columns, camera.rows, values, (*GEOMETRY, *LENS_MODELS[model]), focal_mm)


def difference_steps(vector: Vector) -> Array:
    """Return the (p,) steps for numeric derivatives, each about 1e-3 px at the detector's edge."""
    steps = {"focal_px": 1e-6, "aspect": 1e-6, "centre_col_px": 1e-3, "centre_row_px": 1e-3}
    steps |= dict.fromkeys(BROWN, 1e-6) | dict.fromkeys(TILT, 1e-6) | dict.fromkeys(RADIAL, 1e-6)
    return np.array([steps[n] for n in vector.free])


def most_allowed_sigma(vector: Vector) -> Array:
    """Return the (p,) standard deviations above which a parameter is undetermined: half a percent for focal length
    and aspect, a fiftieth of the detector for the centre, and one pixel at the corner for a coefficient."""
    camera = vector.camera()
    corner = float(np.tan(min(camera.half_diagonal_rad, 1.2)))
    reach_px = 1.0 / vector.values["focal_px"]
    mm = corner * vector.focal_mm
    limits = {"focal_px": 0.005, "aspect": 0.005}
    limits |= {"centre_col_px": 0.02 * camera.columns, "centre_row_px": 0.02 * camera.rows}
    limits |= {"k1": reach_px / corner**3, "k2": reach_px / corner**5, "k3": reach_px / corner**7}
    limits |= dict.fromkeys(("p1", "p2"), reach_px / corner**2) | dict.fromkeys(TILT, reach_px / corner**2)
    limits |= {n: reach_px * vector.focal_mm / mm ** (k + 1) for k, n in enumerate(RADIAL)}
    return np.array([limits[n] for n in vector.free])
