"""Profiles of the five cameras in the documents. ``sources`` gives the source of every constant, or says that it was
chosen."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gss.domain.camera import Brown, Camera, RadialTilt
from gss.domain.errors import NotFound
from gss.domain.sensor import Baffle, Defects, Sensor


@dataclass(frozen=True)
class CameraProfile:
    """One instrument: geometry, photometry, and where each number comes from."""

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

    @property
    def aperture_cm2(self) -> float:
        """Area of the entrance pupil."""
        return float(np.pi / 4 * (self.focal_mm / 10 / self.f_number) ** 2)


def _zero_point_e_s(focal_mm: float, f_number: float, transmission: float, efficiency: float) -> float:
    """Electrons per second from a star of V = 0: 10³ photons/(s cm² Å) over 3000 Å (Erlank 2013 eq. 3.4.2), times
    lens transmission and quantum efficiency."""
    aperture_cm2 = np.pi / 4 * (focal_mm / 10 / f_number) ** 2
    return float(aperture_cm2 * transmission * 3000 * 1e3 * efficiency)


def _baffle(sun_deg: float, earth_deg: float, pixel_mm2: float, f_number: float, half_diagonal_deg: float) -> Baffle:
    """Baffle with a stray light at the limit of 154 e/s per pixel for 20 µm pixels behind f/1.4 (Moniteq 1983 Table
    5.3, 21°), scaled for other cameras by the etendue of a pixel.

    The Sun is taken to blind the camera within 5° of the corner of the field of view (chosen).
    """
    etendue = (pixel_mm2 / f_number**2) / (0.020**2 / 1.4**2)
    blind_deg = min(sun_deg, half_diagonal_deg + 5.0)
    return Baffle(
        float(np.radians(sun_deg)),
        float(np.radians(earth_deg)),
        float(np.radians(blind_deg)),
        float(np.radians(3.0)),
        154.0 * float(etendue),
    )


def _cubestar() -> CameraProfile:
    focal_mm, pitch_mm = 6.28, 0.0056
    distortion = Brown(k1=-0.32358, k2=0.12456, p1=0.00414, p2=-0.00624)
    return CameraProfile(
        "cubestar",
        "CubeStar (Erlank 2013)",
        Camera.from_optics(1024, 512, pitch_mm, pitch_mm, focal_mm, distortion),
        Sensor(
            bits=8,
            gain_e_per_dn=5.0,
            bias_dn=8.0,
            full_well_e=5000.0,
            read_noise_e=6.0,
            dark_current_e_s=40.0,
            background_e_s=20.0,
            zero_point_e_s=_zero_point_e_s(focal_mm, 1.2, 0.6, 0.5),
            psf_sigma_px=1.2,
            bright_limit_mag=-1.5,
            faint_limit_mag=3.8,
            exposure_min_s=0.001,
            exposure_max_s=1.0,
            exposure_s=0.25,
        ),
        focal_mm,
        pitch_mm,
        pitch_mm,
        1.2,
        {
            "columns, rows, pitch": "Erlank 2013 Table 3.3 (Melexis MLX75412, 1024 x 512, 5.6 µm)",
            "focal length": "Erlank 2013 §5.4, measured 6.28 mm",
            "f-number": "Erlank 2013 §3.5.4",
            "distortion": "Erlank 2013 Fig. 5.12, toolbox coefficients in the ideal-to-measured direction",
            "optical centre": "middle of the detector: the toolbox's is uncertain by 15 px, the measured one is not printed",
            "bits": "Erlank 2013 app. C, upper eight of twelve",
            "limiting magnitude": "Erlank 2013 §3.5.3, §4.3.2 (405 stars to V 3.8)",
            "zero point": "Erlank 2013 eq. 3.4.2, transmission 0.6, 3000 Å, with the f/1.2 pupil; efficiency 0.5 chosen",
            "psf": "chosen so that faint stars cover the 9–30 px of Erlank 2013 §5.4",
            "gain, bias, noise": "chosen: the document gives SNR10 only",
            "defects, baffle": "chosen: a CMOS imager, an f/1.2 lens; Erlank 2013 Table 7.1 is without baffle",
        },
        Defects(0.01, 0.25, 0.3, 0.1, 1e-4, 2000.0, 2e-5, 0.35),
        _baffle(45.0, 40.0, pitch_mm**2, 1.2, 31.0),
    )


def _sunsat() -> CameraProfile:
    focal_mm, col_mm, row_mm = 25.0, 0.0065, 0.00625
    # F.7 prints (1.77, 2.64) mm for (hor, vert); the detector's own middle is (2.61, 1.89), so the two are swapped.
    centre_col_px = (2.64 - 25 * col_mm) / col_mm - 0.5
    centre_row_px = 581 - ((1.77 - 12 * row_mm) / row_mm - 0.5)
    distortion = RadialTilt(focal_mm, np.radians(0.733), np.radians(306.0 - 180.0), (1e-3, -8e-5, -4.4e-4))
    return CameraProfile(
        "sunsat",
        "Sunsat star sensor (Jacobs 1995)",
        Camera(752, 582, focal_mm / col_mm, focal_mm / row_mm, centre_col_px, centre_row_px, distortion),
        Sensor(
            bits=8,
            gain_e_per_dn=35.0,
            bias_dn=10.0,
            full_well_e=30_000.0,
            read_noise_e=40.0,
            dark_current_e_s=60.0,
            background_e_s=60.0,
            zero_point_e_s=_zero_point_e_s(focal_mm, 1.4, 0.8, 0.3),
            psf_sigma_px=1.2,
            bright_limit_mag=2.5,
            faint_limit_mag=6.0,
            exposure_min_s=0.02,
            exposure_max_s=1.0,
            exposure_s=0.5,
        ),
        focal_mm,
        col_mm,
        row_mm,
        1.4,
        {
            "columns, rows, pitch": "Jacobs 1995 §1.1 (Sony ICX059AL, 752 x 582, 6.5 x 6.25 µm)",
            "focal length, f-number": "Jacobs 1995 §9.1 (Cosmicar 25 mm f/1.4)",
            "optical centre": "Jacobs 1995 eq. F.7 with hor and vert exchanged",
            "tilt": "Jacobs 1995 eq. F.8, 0.733° at 306° from +u to +v; +u is −x, +v is −y",
            "radial polynomial": "Jacobs 1995 eq. F.9, millimetres",
            "limiting magnitudes": "Jacobs 1995 §6.3 (V 2.5 to 6)",
            "psf": "Jacobs 1995 §9.2.2: σ between 1 and 2.5 px",
            "gain, noise, exposure": "chosen so that V 3 begins to saturate (Jacobs 1995 §6.3) and V 6 is found",
            "defects, baffle": "dark pattern after Jacobs 1995 §8.5, the rest chosen; limits 28.1°: eq. 7.26",
        },
        Defects(0.01, 0.2, 0.0, 0.3, 5e-5, 1500.0, 5e-6, 0.2),
        _baffle(28.1, 28.1, col_mm * row_mm, 1.4, 7.0),
    )


def _far_mst() -> CameraProfile:
    focal_mm, pitch_mm, area_cm2 = 15.97, 0.0067, 1.77
    f_number = focal_mm / 10 / (2 * np.sqrt(area_cm2 / np.pi))
    return CameraProfile(
        "far_mst",
        "FAR-MST / LIST (Huffman 2006)",
        Camera.from_optics(1280, 1024, pitch_mm, pitch_mm, focal_mm, Brown()),
        Sensor(
            bits=10,
            gain_e_per_dn=10.0,
            bias_dn=20.0,
            full_well_e=120_000.0,
            read_noise_e=39.0,
            dark_current_e_s=410.0,
            background_e_s=50.0,
            zero_point_e_s=_zero_point_e_s(focal_mm, f_number, 0.8, 0.35),
            psf_sigma_px=1.25,
            bright_limit_mag=-1.5,
            faint_limit_mag=4.5,
            exposure_min_s=0.01,
            exposure_max_s=1.0,
            exposure_s=0.1,
        ),
        focal_mm,
        pitch_mm,
        pitch_mm,
        float(f_number),
        {
            "columns, rows, pitch, focal length": "Huffman 2006 Table 7.1",
            "lens area": "Huffman 2006 Table 7.1, 1.77 cm²",
            "gain, dark, read noise": "Huffman 2006 Table 7.1",
            "full well": "Huffman 2006 §3.2.4",
            "psf": "Huffman 2006 §4.2.2: best PSF width about 5 px at SNR 3, width = 4σ",
            "efficiency": "chosen; the document's FFSR of 0.12 A/W is its source",
            "defects, baffle": "chosen: a CMOS imager with column amplifiers",
        },
        Defects(0.01, 0.7, 0.8, 0.1, 1e-4, 4000.0, 2e-5, 0.2),
        _baffle(40.0, 30.0, pitch_mm**2, float(f_number), 19.0),
    )


def _oersted() -> CameraProfile:
    col_mm, row_mm = 0.0100, 0.0078
    diagonal_mm = float(np.hypot(604 * col_mm, 576 * row_mm))
    focal_mm = diagonal_mm / 2 / float(np.tan(np.radians(15.0)))
    return CameraProfile(
        "oersted",
        "Oersted star imager (Liebe 1992)",
        Camera.from_optics(604, 576, col_mm, row_mm, focal_mm, Brown()),
        Sensor(
            bits=8,
            gain_e_per_dn=120.0,
            bias_dn=10.0,
            full_well_e=60_000.0,
            read_noise_e=60.0,
            dark_current_e_s=100.0,
            background_e_s=80.0,
            zero_point_e_s=_zero_point_e_s(focal_mm, 0.8, 0.8, 0.3),
            psf_sigma_px=1.0,
            bright_limit_mag=-1.5,
            faint_limit_mag=4.5,
            exposure_min_s=0.05,
            exposure_max_s=2.0,
            exposure_s=0.8,
        ),
        focal_mm,
        col_mm,
        row_mm,
        0.8,
        {
            "columns, rows": "Liebe 1992 Table 4 (NXA 1011, 576 x 604)",
            "opening angle": "Liebe 1992 Table 4: 30°, taken as the full diagonal; the focal length follows",
            "f-number, exposure": "Liebe 1992 Table 4 (f/0.8, 0.8 s)",
            "pitch": "not in the document: 10.0 x 7.8 µm, the chip's nominal cell",
            "limiting magnitude": "Liebe 1992: 1100 brightest stars, about V 4.5",
            "gain, noise": "chosen",
            "defects, baffle": "chosen: a frame-transfer CCD, a wide f/0.8 lens",
        },
        Defects(0.01, 0.2, 0.0, 0.2, 5e-5, 1000.0, 5e-6, 0.4),
        _baffle(45.0, 35.0, col_mm * row_mm, 0.8, 15.0),
    )


def _aim() -> CameraProfile:
    focal_mm, pitch_mm = 85.0, 0.020
    return CameraProfile(
        "aim",
        "AIM smart camera (Moniteq 1983)",
        Camera.from_optics(256, 256, pitch_mm, pitch_mm, focal_mm, Brown()),
        Sensor(
            bits=12,
            gain_e_per_dn=60.0,
            bias_dn=50.0,
            full_well_e=300_000.0,
            read_noise_e=60.0,
            dark_current_e_s=500.0,
            background_e_s=100.0,
            zero_point_e_s=_zero_point_e_s(focal_mm, 1.4, 0.8, 0.3),
            psf_sigma_px=0.45,
            bright_limit_mag=0.0,
            faint_limit_mag=6.5,
            exposure_min_s=0.02,
            exposure_max_s=2.0,
            exposure_s=0.2,
        ),
        focal_mm,
        pitch_mm,
        pitch_mm,
        1.4,
        {
            "columns, rows": "Moniteq 1983 §3 (256 x 256 CID)",
            "lens": "Moniteq 1983 §5.1 (85 mm f/1.4)",
            "pitch": "from the recommended 3.45° field: 20 µm",
            "bits": "Moniteq 1983 §3.2 (12-bit converter)",
            "psf": "Moniteq 1983 §4.2: pixel/σ between 2 and 2.5",
            "gain, noise": "chosen within the budget of Moniteq 1983 §3.7",
            "defects, baffle": "Moniteq 1983 Table 3.1, pattern as left after its subtraction (§3.4), Sun 20° (§5.2)",
        },
        Defects(0.005, 1.0, 1.0, 0.015, 1e-4, 5000.0, 2e-5, 0.1),
        _baffle(20.0, 20.0, pitch_mm**2, 1.4, 2.5),
    )


PROFILES: dict[str, CameraProfile] = {p.name: p for p in (_sunsat(), _cubestar(), _far_mst(), _oersted(), _aim())}


def profile(name: str) -> CameraProfile:
    """Return the profile of that name; NotFound if there is none."""
    try:
        return PROFILES[name]
    except KeyError:
        raise NotFound("unknown camera profile", expected=" | ".join(PROFILES), got=name) from None
