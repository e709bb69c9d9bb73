"""Export of a frame as a FITS file with the world coordinates of its solution."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from gss.domain.aberration import aberrate
from gss.domain.angles import Array
from gss.domain.camera import Camera, Pinhole
from gss.domain.camera_record import camera_from
from gss.domain.dark_columns import DarkColumns
from gss.domain.frames import ra_dec_roll_rad
from gss.domain.rotation import matrix_from_quaternion
from gss.operations.frames.frame_values import dark_columns_of
from gss.operations.frames.observer import drawn_without_aberration
from gss.operations.frames.pictures import Pixels
from gss.store.models import Frame, Solution

MJD_ZERO = datetime(1858, 11, 17, tzinfo=UTC)
GRID_POINTS = 41
SIP_ORDER = 7


def fits_file(picture: Pixels, frame: Frame, solution: Solution | None) -> bytes:
    """Return the complete rows of a frame as a FITS file. If the rows have dark columns, DATASEC and DARKSECn state which
    columns are light-sensitive and dark. If the solution has an attitude, the header contains a gnomonic WCS of catalogue
    positions. SIP polynomials describe the camera's distortion, and aberration if the solution was corrected for it."""
    from astropy.io import fits

    hdu = fits.PrimaryHDU(np.ascontiguousarray(picture))
    header = hdu.header
    dark = dark_columns_of(frame)
    header.update(
        image_cards(
            f"frame {frame.id}",
            frame.taken if frame.time_known else None,
            frame.exposure_s,
            frame.profile,
            dark,
            (frame.rows, frame.columns),
            simulated=drawn_without_aberration(frame),
        )
    )
    if solution is not None and solution.quaternion is not None:
        attitude = matrix_from_quaternion(np.array(solution.quaternion, float))
        velocity_c = (solution.detail or {}).get("velocity_c")
        view = _View(
            camera_from(solution.camera), attitude, None if velocity_c is None else np.array(velocity_c, float)
        )
        header.update(_world_coordinates(view))
        header["CRPIX1"] += dark.left
        header["HISTORY"] = f"attitude by {solution.chain} {solution.version}, {solution.matched} stars"
    buffer = io.BytesIO()
    hdu.writeto(buffer)
    return buffer.getvalue()


Cards = dict[str, str | float | tuple[str | float | bool, str]]
"""FITS header cards: keyword to value, or to value and comment."""


def image_cards(
    title: str,
    taken: datetime | None,
    exposure_s: float | None,
    camera: str | None,
    dark: DarkColumns,
    shape: tuple[int, int],
    *,
    simulated: bool,
) -> Cards:
    """Return the header cards of an image. ``taken``: time of mid-exposure, None if unknown. ``shape``: rows and
    light-sensitive columns. ``simulated``: True if the sky was drawn without aberration."""
    cards: Cards = {}
    if taken is not None:
        cards["DATE-OBS"] = taken.strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3]
        cards["MJD-OBS"] = (taken - MJD_ZERO).total_seconds() / 86400
    cards["OBJECT"] = title
    cards["CREATOR"] = "gss"
    if dark.count:
        rows, columns = shape
        first, last = dark.left + 1, dark.left + columns
        cards["DATASEC"] = f"[{first}:{last},1:{rows}]"
        for k, (a, b) in enumerate(((1, dark.left), (last + 1, last + dark.right))):
            cards[f"DARKSEC{k + 1}"] = f"[{a}:{b},1:{rows}]"
    if exposure_s is not None:
        cards["EXPTIME"] = (exposure_s, "s")
    if camera:
        cards["INSTRUME"] = camera
    if simulated:
        cards["GSSABERR"] = (False, "simulated: the sky was drawn without aberration")
    return cards


def rendered_file(
    picture: Pixels, title: str, taken: datetime, exposure_s: float, camera: str, dark: DarkColumns
) -> bytes:
    """Return the complete rows of a rendered image as a FITS file with its time, exposure and camera."""
    from astropy.io import fits

    shape = picture.shape[0], picture.shape[1] - dark.count
    hdu = fits.PrimaryHDU(np.ascontiguousarray(picture))
    hdu.header.update(image_cards(title, taken, exposure_s, camera, dark, shape, simulated=True))
    buffer = io.BytesIO()
    hdu.writeto(buffer)
    return buffer.getvalue()


@dataclass(frozen=True)
class _View:
    """Camera and attitude of a solution. ``velocity_c``: velocity of the observer in units of c, None if aberration was not
    corrected."""

    camera: Camera
    cam_from_icrs: Array
    velocity_c: Array | None

    def catalogue_directions(self, rays: Array) -> Array:
        """Return (n, 3) ICRS catalogue directions of (n, 3) unit vectors in the camera frame."""
        apparent = rays @ self.cam_from_icrs
        return apparent if self.velocity_c is None else aberrate(apparent, -self.velocity_c)

    def catalogue_attitude(self) -> Array:
        """Return the (3, 3) attitude of the camera relative to catalogue positions at the boresight."""
        if self.velocity_c is None:
            return self.cam_from_icrs
        boresight, beside = self.catalogue_directions(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]))
        across = beside - (beside @ boresight) * boresight
        across /= np.linalg.norm(across)
        return np.stack([across, np.cross(boresight, across), boresight])


def _world_coordinates(view: _View) -> Cards:
    """Return TAN header cards, with SIP polynomials (Shupe et al. 2005) if the mapping is not linear. FITS counts pixels from 1."""
    camera, attitude = view.camera, view.catalogue_attitude()
    ra, dec, roll = ra_dec_roll_rad(attitude)
    c, s = np.cos(roll), np.sin(roll)
    east_north_from_cam = np.array([[-c, s], [-s, -c]])
    cd_deg = np.degrees(east_north_from_cam @ np.diag([1 / camera.focal_col_px, 1 / camera.focal_row_px]))
    linear = view.velocity_c is None and isinstance(camera.distortion, Pinhole)
    suffix = "" if linear else "-SIP"
    cards: Cards = {
        "CTYPE1": f"RA---TAN{suffix}",
        "CTYPE2": f"DEC--TAN{suffix}",
        "CUNIT1": "deg",
        "CUNIT2": "deg",
        "CRVAL1": float(np.degrees(ra)),
        "CRVAL2": float(np.degrees(dec)),
        "CRPIX1": camera.centre_col_px + 1,
        "CRPIX2": camera.centre_row_px + 1,
        "RADESYS": "ICRS",
    }
    cards |= {f"CD{i + 1}_{j + 1}": float(cd_deg[i, j]) for i in range(2) for j in range(2)}
    return cards if linear else cards | _sip(view, attitude)


def _sip(view: _View, catalogue_attitude: Array) -> Cards:
    """Fit SIP polynomials to both directions of the mapping over the detector, and return their header cards. The variables are
    offsets from the optical centre."""
    camera = view.camera
    focal = np.array([camera.focal_col_px, camera.focal_row_px])
    centre = np.array([camera.centre_col_px, camera.centre_row_px])
    cols, rows = np.meshgrid(
        np.linspace(0, camera.columns - 1, GRID_POINTS), np.linspace(0, camera.rows - 1, GRID_POINTS)
    )
    pixels = np.column_stack([cols.ravel(), rows.ravel()])
    directions = view.catalogue_directions(camera.unproject(pixels)) @ catalogue_attitude.T
    measured, ideal = pixels - centre, directions[:, :2] / directions[:, 2:] * focal
    cards: Cards = {}
    for names, start, end in ((("A", "B"), measured, ideal), (("AP", "BP"), ideal, measured)):
        cards |= {f"{name}_ORDER": SIP_ORDER for name in names}
        cards |= _polynomials(names, start, end - start)
    return cards


def _polynomials(names: Sequence[str], at: Array, values: Array) -> dict[str, float]:
    """Return the coefficients of one polynomial per column of the (n, names) ``values`` at the (n, 2) places."""
    powers = [(p, q) for p in range(SIP_ORDER + 1) for q in range(SIP_ORDER + 1 - p)]
    scale = float(np.abs(at).max())
    u, v = at.T / scale
    solutions = np.linalg.lstsq(np.column_stack([u**p * v**q for p, q in powers]), values, rcond=None)[0]
    return {
        f"{name}_{p}_{q}": float(k / scale ** (p + q))
        for name, solution in zip(names, solutions.T, strict=True)
        for (p, q), k in zip(powers, solution, strict=True)
    }
