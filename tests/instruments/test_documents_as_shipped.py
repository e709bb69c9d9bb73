"""The shipped units agree with the documents of their instruments: field of view, stars, photometry and timing."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from gss.catalogue_tools.onboard import decode
from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.results import Verdict
from gss.domain.rotation import matrix_from_quaternion
from gss.instruments.golden import build_golden
from gss.instruments.package_files import SimulatorFile, UnitTiming
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.pipeline.chains import onboard
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.oersted_match import prepare
from gss.pipeline.chains.onboard import Commanded, Work
from gss.pipeline.chains.systems import system
from gss.pipeline.render import render
from gss.pipeline.score import score

BANK_BYTES = 196_608
SKY_DEG2 = 41_253.0


def _field_deg2(name: str) -> float:
    """Return the solid angle that the detector covers with a lens without distortion, in square degrees."""
    camera = shipped_camera(name).camera
    a, b = camera.columns / 2 / camera.focal_col_px, camera.rows / 2 / camera.focal_row_px
    return float(np.degrees(np.degrees(4 * np.arcsin(a * b / np.sqrt((1 + a * a) * (1 + b * b))))))


def _timing(name: str) -> UnitTiming:
    return (shipped_registry().get(name).simulator or SimulatorFile()).timing


def test_oersted_sees_the_stars_of_its_document() -> None:
    """The field has the area of a 30° circle. Of 1539 stars on board 1107 are used, 18.9 in an average image
    (Liebe 1992 Fig. 2, Table 4)."""
    profile = shipped_camera("oersted")
    bank = decode(build_golden(profile, BANK_BYTES).image)
    used = int(np.count_nonzero(bank.v_mag <= prepare(bank, profile).triplets.limit_mag))
    assert len(bank) == pytest.approx(1539, rel=0.01)
    assert used == pytest.approx(1107, rel=0.05)
    assert _field_deg2("oersted") == pytest.approx(703, rel=0.005)
    assert used * _field_deg2("oersted") / SKY_DEG2 == pytest.approx(18.9, rel=0.05)


def test_oersted_solves_rendered_frames_as_its_document() -> None:
    """At least 25 of 30 images are solved and none wrongly. Liebe 1992 Table 2 states about 95 % for the initial
    estimate."""
    profile = shipped_camera("oersted")
    golden, chain = build_golden(profile, BANK_BYTES), system("oersted")
    bank = chain.prepare(replace(decode(golden.image), hip=golden.hip), profile)
    parameters = chain.parameters(profile, None, Commanded(), Mode.LOST_IN_SPACE)
    work = Work(profile.camera, bank, parameters, Mode.LOST_IN_SPACE, None)
    stars = propagate(load_stars(7.0), 2026.0)
    verdicts: Counter[Verdict] = Counter()
    for k in range(30):
        rng = np.random.default_rng([20, k])
        quaternion = rng.normal(size=4)
        attitude = matrix_from_quaternion(quaternion / np.linalg.norm(quaternion))
        frame = render(stars, profile.camera, profile.sensor, attitude, profile.sensor.exposure_s, rng)
        verdicts[score(onboard.solve(chain, frame.pixels, work), frame.truth, profile.camera)] += 1
    assert verdicts[Verdict.WRONG] == 0
    assert verdicts[Verdict.CORRECT] >= 25


def test_aim_has_the_photometry_of_its_document() -> None:
    """A star of V 6 gives 1500 e/s per cm² of an 85 mm f/1.4 lens. Dark current, full well, noise and exposures are those
    of Moniteq's tables."""
    sensor = shipped_camera("aim").sensor
    assert float(sensor.star_e(6.0, 1.0)) == pytest.approx(43_425, rel=0.001)
    assert (sensor.dark_current_e_s, sensor.full_well_e, sensor.read_noise_e) == (4000.0, 1.3e6, 73.0)
    assert (sensor.exposure_min_s, sensor.exposure_s, sensor.exposure_max_s) == (0.01, 2.0, 10.0)
    assert sensor.gain_e_per_dn / np.sqrt(12) < sensor.read_noise_e
    assert shipped_registry().get("aim").simulator.motion == "inertial"  # type: ignore[union-attr]
    assert _timing("aim").cycle_ms == 4000


def test_cubestar_has_the_exposures_of_its_imager() -> None:
    """The frame periods are those of Erlank's Table D.2. The default exposure is that of register 7."""
    sensor = shipped_camera("cubestar").sensor
    assert _timing("cubestar").frame_ms == (90, 300, 337, 386, 450)
    assert (sensor.exposure_s, sensor.exposure_max_s) == (0.386, 0.45)
