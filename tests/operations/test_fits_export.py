"""World coordinates of exported FITS files agree with the cameras."""

from __future__ import annotations

import io
from datetime import UTC, datetime

import erfa
import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS

from gss.domain.angles import ra_dec_from_unit
from gss.domain.camera_record import camera_from, record_of
from gss.domain.frames import cam_from_icrs
from gss.domain.rotation import quaternion_from_matrix
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.operations.frames.fits_export import fits_file
from gss.operations.frames.frame_files import WITHOUT_ABERRATION
from gss.store.models import Frame, Solution

VELOCITY_C = np.array([0.4e-4, -1.2e-4, 0.8e-4])


@pytest.mark.parametrize("moving", [False, True], ids=["still", "moving"])
@pytest.mark.parametrize("name", ["cubestar", "sunsat", "far_mst"])
def test_world_coordinates_follow_the_camera_over_the_whole_detector(name, moving):
    """World coordinates read by astropy agree with the camera within 0.05 px, and their inverse within 0.1 px, also if the
    solution was corrected for an aberration of 31″."""
    camera = shipped_camera(name).camera
    attitude = cam_from_icrs(*np.radians([84.0, -60.0, 313.0]))
    taken = datetime(2026, 12, 1, tzinfo=UTC)
    frame = Frame(id=1, number=3, taken=taken, exposure_s=0.25, profile=name, time_known=True, parameters={})
    solution = Solution(
        quaternion=quaternion_from_matrix(attitude).tolist(),
        camera=record_of(camera),
        chain="reference",
        version="1",
        matched=9,
        detail={"velocity_c": VELOCITY_C.tolist()} if moving else {},
    )
    data = fits_file(np.zeros((camera.rows, camera.columns), np.uint8), frame, solution)
    with fits.open(io.BytesIO(data)) as file:
        wcs, header = WCS(file[0].header), file[0].header
    rng = np.random.default_rng(1)
    pixels = rng.uniform([0, 0], [camera.columns - 1, camera.rows - 1], (200, 2))
    theirs = np.radians(wcs.all_pix2world(pixels, 0))
    apparent = camera.unproject(pixels) @ attitude
    ours = np.column_stack(ra_dec_from_unit(true_directions(apparent) if moving else apparent))
    step = np.hypot((theirs - ours)[:, 0] * np.cos(ours[:, 1]), (theirs - ours)[:, 1])
    assert step.max() < 0.05 * camera.pixel_rad
    assert np.abs(wcs.all_world2pix(np.degrees(ours), 0) - pixels).max() < 0.1
    assert (header["INSTRUME"], header["EXPTIME"]) == (name, 0.25)


def test_dark_columns_are_exported_and_the_coordinates_remain_at_the_stars():
    """Complete rows are exported; keywords state the dark columns, and the world coordinates are those of the light-sensitive
    columns."""
    profile = shipped_camera("sunsat")
    attitude = cam_from_icrs(*np.radians([84.0, -60.0, 313.0]))
    taken, parameters = datetime(2026, 12, 1, tzinfo=UTC), {"dark_columns": [3, 40]}
    frame = Frame(id=1, taken=taken, time_known=True, profile="sunsat", columns=752, rows=582, parameters=parameters)
    solution = Solution(
        quaternion=quaternion_from_matrix(attitude).tolist(),
        camera=record_of(profile.camera),
        chain="reference",
        version="1",
        matched=9,
        detail={},
    )
    with fits.open(io.BytesIO(fits_file(np.zeros((582, 795), np.uint8), frame, solution))) as file:
        wcs, header = WCS(file[0].header), file[0].header
    assert header["NAXIS1"] == 795
    assert (header["DATASEC"], header["DARKSEC1"], header["DARKSEC2"]) == (
        "[4:755,1:582]",
        "[1:3,1:582]",
        "[756:795,1:582]",
    )
    pixel = np.array([[200.0, 300.0]])
    ra_dec = np.degrees(np.column_stack(ra_dec_from_unit(profile.camera.unproject(pixel) @ attitude)))
    assert wcs.all_world2pix(ra_dec, 0) - [3, 0] == pytest.approx(pixel, abs=0.1)


def true_directions(apparent):
    """Return (n, 3) directions from which erfa's aberration for the observer's velocity gives the apparent ones."""
    true = apparent.copy()
    for _ in range(5):
        moved = erfa.ab(true, VELOCITY_C, 1.0, np.sqrt(1 - VELOCITY_C @ VELOCITY_C))
        true += apparent - moved
        true /= np.linalg.norm(true, axis=1)[:, None]
    return true


@pytest.mark.parametrize("name", sorted(shipped_registry().cameras()))
def test_a_camera_is_restored_from_plain_values(name):
    """A camera that was stored as plain values with a solution is restored exactly."""
    import json

    camera = shipped_camera(name).camera
    assert camera_from(json.loads(json.dumps(record_of(camera)))) == camera


def test_a_rendered_image_keeps_its_statement_about_aberration() -> None:
    """The export of an imported file that contains no aberration states this too; that of a photograph does not."""
    taken, pixels = datetime(2026, 7, 1, tzinfo=UTC), np.zeros((4, 8), np.uint8)
    for source, card in (({WITHOUT_ABERRATION: "yes"}, False), ({"format": "FITS"}, None)):
        frame = Frame(id=1, taken=taken, time_known=True, columns=8, rows=4, parameters={"file": source})
        with fits.open(io.BytesIO(fits_file(pixels, frame, None))) as file:
            assert file[0].header.get("GSSABERR") is card
