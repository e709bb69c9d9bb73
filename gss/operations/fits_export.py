"""A frame as a FITS file with the world coordinates of its solution."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from gss.domain.angles import ra_dec_from_unit
from gss.domain.camera import Camera
from gss.domain.rotation import matrix_from_quaternion
from gss.operations.camera_record import camera_from
from gss.operations.pictures import Pixels
from gss.store.models import Frame, Solution

GRID_POINTS = 21
SIP_DEGREE = 5


def fits_file(pixels: Pixels, frame: Frame, solution: Solution | None) -> bytes:
    """FITS bytes; gnomonic WCS with SIP polynomials fitted to the camera's distortion when there is an attitude."""
    from astropy.io import fits

    hdu = fits.PrimaryHDU(np.ascontiguousarray(pixels))
    header = hdu.header
    header["DATE-OBS"] = frame.taken.strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3]
    header["OBJECT"] = f"frame {frame.number or frame.id}"
    header["CREATOR"] = "gss"
    if frame.exposure_s is not None:
        header["EXPTIME"] = (frame.exposure_s, "s")
    if frame.profile:
        header["INSTRUME"] = frame.profile
    if solution is not None and solution.quaternion is not None:
        header.update(_wcs(camera_from(solution.camera), np.array(solution.quaternion, float)).to_header(relax=True))
        header["HISTORY"] = f"attitude by {solution.chain} {solution.version}, {solution.matched} stars"
    buffer = io.BytesIO()
    hdu.writeto(buffer)
    return buffer.getvalue()


def _wcs(camera: Camera, quaternion: Any) -> Any:
    from astropy.coordinates import SkyCoord
    from astropy.wcs.utils import fit_wcs_from_points

    cols, rows = np.meshgrid(
        np.linspace(0, camera.columns - 1, GRID_POINTS), np.linspace(0, camera.rows - 1, GRID_POINTS)
    )
    points = np.column_stack([cols.ravel(), rows.ravel()])
    ra, dec = ra_dec_from_unit(camera.unproject(points) @ matrix_from_quaternion(quaternion))
    centre_ra, centre_dec = ra_dec_from_unit(matrix_from_quaternion(quaternion)[2])
    centre = SkyCoord(centre_ra, centre_dec, unit="rad")
    sky = SkyCoord(ra, dec, unit="rad")
    straight = type(camera.distortion).__name__ == "Pinhole"
    return fit_wcs_from_points(
        (points[:, 0], points[:, 1]), sky, proj_point=centre, sip_degree=None if straight else SIP_DEGREE
    )
