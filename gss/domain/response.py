"""Spectral response of detector and lens, one curve per profile.

No document contains a usable curve (Moniteq 1983 Fig. 3.11 is lost). All curves are therefore typical of the detector type and
are scaled to the single values that the documents print. ``source`` of each curve states this.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput


@dataclass(frozen=True)
class SpectralResponse:
    """Output per watt of light as a function of wavelength, including the lens. The unit is A/W if the source states
    this unit; otherwise the values are relative.

    ``wavelength_nm`` is ascending. Values are interpolated linearly and are zero outside the range.
    """

    name: str
    source: str
    wavelength_nm: tuple[float, ...]
    a_per_w: tuple[float, ...]

    def __post_init__(self) -> None:
        wavelength, value = np.array(self.wavelength_nm, float), np.array(self.a_per_w, float)
        if len(wavelength) != len(value) or len(wavelength) < 2 or not np.all(np.diff(wavelength) > 0):
            raise BadInput(
                "the response curve is not valid",
                expected="two or more wavelengths, ascending, with a value each",
                got=f"{len(wavelength)} wavelengths and {len(value)} values",
            )
        if not (np.isfinite(wavelength).all() and np.isfinite(value).all() and (value >= 0).all() and value.max() > 0):
            raise BadInput("the response curve is not valid", expected="finite values, none negative, one above zero")

    def at(self, wavelength_nm: Array) -> Array:
        """Return the response at each wavelength."""
        return np.asarray(np.interp(wavelength_nm, self.wavelength_nm, self.a_per_w, left=0.0, right=0.0))


def _relative(name: str, source: str, points: dict[int, float], scale: float = 1.0) -> SpectralResponse:
    return SpectralResponse(name, source, tuple(map(float, points)), tuple(scale * v for v in points.values()))


GENERIC = _relative(
    "silicon behind glass",
    "chosen: front-lit silicon behind a glass lens",
    {
        360: 0.0,
        400: 0.25,
        450: 0.5,
        500: 0.7,
        550: 0.85,
        600: 0.95,
        650: 1.0,
        700: 0.97,
        800: 0.75,
        900: 0.42,
        1000: 0.1,
        1080: 0.0,
    },
)
RESPONSES: dict[str, SpectralResponse] = {
    "sunsat": _relative(
        "interline CCD",
        "chosen: typical of an interline CCD (Sony ICX059AL); Jacobs 1995 app. H.4 gives its lamp of 3200 K only",
        {
            360: 0.0,
            400: 0.5,
            450: 0.82,
            500: 1.0,
            550: 0.96,
            600: 0.82,
            650: 0.67,
            700: 0.5,
            800: 0.25,
            900: 0.1,
            1000: 0.02,
            1060: 0.0,
        },
    ),
    "cubestar": _relative(
        "CMOS, near infrared enhanced",
        "chosen: typical of a driving-aid CMOS (Melexis MLX75412); Erlank 2013 Table 6 names 535 nm only",
        {
            360: 0.0,
            400: 0.35,
            450: 0.62,
            500: 0.85,
            550: 0.97,
            600: 1.0,
            650: 0.98,
            700: 0.9,
            800: 0.65,
            900: 0.35,
            1000: 0.1,
            1080: 0.0,
        },
    ),
    "far_mst": _relative(
        "CMOS (IBIS5-A-1300)",
        "chosen shape; peak 0.16 A/W of the trade table, Huffman 2006 §2.2.3 (its simulations use a mean of 0.12 A/W, Table 7.1)",
        {
            360: 0.0,
            400: 0.3,
            450: 0.55,
            500: 0.75,
            550: 0.9,
            600: 0.98,
            650: 1.0,
            700: 0.98,
            800: 0.75,
            900: 0.42,
            1000: 0.1,
            1080: 0.0,
        },
        0.16,
    ),
    "oersted": _relative(
        "frame-transfer CCD",
        "chosen: typical of a front-lit frame-transfer CCD (NXA 1011), weak in the blue; Liebe 1992 prints the law, not the curve",
        {
            380: 0.0,
            420: 0.2,
            450: 0.35,
            500: 0.6,
            550: 0.75,
            600: 0.88,
            650: 0.97,
            700: 1.0,
            800: 0.9,
            900: 0.5,
            1000: 0.12,
            1080: 0.0,
        },
    ),
    "aim": _relative(
        "CID",
        "chosen shape with the mean of 0.15 A/W between 400 and 1000 nm, Moniteq 1983 Table 3.2 (its Fig. 3.11 is lost)",
        {
            350: 0.0,
            400: 0.45,
            450: 0.7,
            500: 0.85,
            550: 0.95,
            600: 1.0,
            650: 0.98,
            700: 0.92,
            800: 0.7,
            900: 0.4,
            1000: 0.12,
            1080: 0.0,
        },
        0.15 / 0.6997,
    ),
}


def response_of(profile: CameraProfile) -> SpectralResponse:
    """Return the curve of a profile. Cameras other than the five published ones use silicon behind glass."""
    return RESPONSES.get(profile.name, GENERIC)
