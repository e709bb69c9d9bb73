"""Render the picture that a camera takes through a second, identical lens that faces it (Erlank 2013 §5.4, Fig. 5.9)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.sensor import Sensor
from gss.pipeline.readout import Image, expose

PEAK_SHARE = 0.7
"""Brightness of the centre of the circle as a share of the range of the camera. A user of a bench sets the lamp so."""
RATIO_RANGE, MAX_OFF = (0.01, 2.0), 1.0


@dataclass(frozen=True)
class SecondLens:
    """A second lens in front of the lens of a camera. ``ratio``: diameter of the pupils divided by the distance between
    them. ``off``: displacement of the second lens along +x and +y of the camera, in diameters of a pupil."""

    ratio: float = 0.2
    off: tuple[float, float] = (0.0, 0.0)


def through_second_lens(camera: Camera, sensor: Sensor, lens: SecondLens, rng: np.random.Generator) -> Image:
    """Render the circle of light with the exposure of the camera. The rows include the dark columns of the detector.

    The open end of the second lens receives diffuse light. A pixel receives light through the common area of the two
    pupils in the direction of the pixel. This area is largest on the optical axis and decreases to zero at a tangent of
    ``ratio``. The illumination decreases with cos⁴ as well. The document shows the picture without a model. Raises
    BadInput for values that give no picture.
    """
    low, high = RATIO_RANGE
    if not low <= lens.ratio <= high:
        raise BadInput("ratio of the pupils is out of range", expected=f"{low:g} – {high:g}", got=f"{lens.ratio:g}")
    if not np.hypot(*lens.off) < MAX_OFF:
        got = f"{np.hypot(*lens.off):g}"
        raise BadInput("second lens is too far off", expected=f"less than {MAX_OFF:g} diameters of a pupil", got=got)
    col, row = np.meshgrid(np.arange(camera.columns), np.arange(camera.rows))
    rays = camera.unproject(np.column_stack([col.ravel(), row.ravel()]).astype(float))
    tangent = rays[:, :2] / rays[:, 2:]
    share = common_area(np.hypot(*(tangent / lens.ratio - np.array(lens.off)).T)) * rays[:, 2] ** 4
    range_e = min(sensor.full_well_e, (sensor.saturation_dn - sensor.bias_dn) * sensor.gain_e_per_dn)
    light_e = (PEAK_SHARE * range_e * share).reshape(camera.rows, camera.columns)
    return expose(light_e, sensor, sensor.exposure_s, rng, dark_columns=sensor.dark_columns)


def common_area(distance: Array) -> Array:
    """Return the common area of two equal circles, as a share of the area of one. ``distance``: (n,) distances between
    the centres, in diameters."""
    s = np.clip(distance, 0.0, 1.0)
    return np.asarray(2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s)))
