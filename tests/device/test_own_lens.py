"""A simulated unit whose lens differs from its document. The sky is rendered with this lens, and the unit knows it only
from an uploaded table."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.device.protocol.transfer import Compatibility
from gss.device.simulator.own_lens import own_lens
from gss.device.simulator.program import main
from gss.device.simulator.sky import SimulatedSky
from gss.device.table_use import calibration_values
from gss.device.tables import TABLE_FORMAT, encode_table
from gss.domain.camera import RadialTilt
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.pipeline.calibration.apply import camera_difference

if TYPE_CHECKING:
    from conftest import Bench

BANK_A = 0


@pytest.mark.parametrize("name", sorted(i.name for i in shipped_registry().all() if i.profile.chain))
def test_the_lens_deviation_is_proportional_and_reproducible(name: str) -> None:
    """A deviation of 1 % changes the focal length by 1 % and the centre by 4 px. The same seed gives the same lens, and a
    deviation of 0 the document's lens. More than 10 % is rejected."""
    document_profile = shipped_camera(name)
    deviating, repeated, other_seed = (
        own_lens(document_profile, 1.0, 5),
        own_lens(document_profile, 1.0, 5),
        own_lens(document_profile, 1.0, 6),
    )
    assert deviating == repeated
    assert deviating.camera != other_seed.camera
    assert own_lens(document_profile, 0.0, 5) is document_profile
    assert deviating.camera.focal_col_px == pytest.approx(1.01 * document_profile.camera.focal_col_px)
    centre_shift_px = np.hypot(
        deviating.camera.centre_col_px - document_profile.camera.centre_col_px,
        deviating.camera.centre_row_px - document_profile.camera.centre_row_px,
    )
    assert centre_shift_px == pytest.approx(4.0)
    half_rms_px, full_rms_px = (
        camera_difference(document_profile.camera, own_lens(document_profile, p, 5).camera).rms_px for p in (0.5, 1.0)
    )
    assert full_rms_px == pytest.approx(2 * half_rms_px, rel=0.1)
    if isinstance(document_profile.camera.distortion, RadialTilt):
        assert deviating.camera.distortion.focal_mm == pytest.approx(deviating.focal_mm)
    with pytest.raises(BadInput, match="lens error is out of range"):
        own_lens(document_profile, 11.0, 5)


def test_an_impossible_lens_is_rejected_at_the_start(capsys: pytest.CaptureFixture[str]) -> None:
    """An invalid lens deviation ends the simulator with exit code 2 and a message."""
    assert main(["--instrument", "cubestar", "--pty", "--lens-off", "40"]) == 2
    assert "at most 10 %" in capsys.readouterr().err


def test_the_unit_matches_more_with_the_table_of_its_lens(make_bench: Callable[..., Bench]) -> None:
    """With a lens deviation of 0.5 %, the table of the real lens gives at least twice the matches of the factory table."""
    bench = make_bench()
    bench.until(lambda: bench.host.hello is not None)
    document_profile: CameraProfile = bench.tracker.profile
    real_profile, document_sky = own_lens(document_profile, 0.5, 3), bench.tracker.sky
    bench.tracker.imager._sky = bench.tracker.sky = SimulatedSky(
        real_profile, document_sky.environment.motion, 2026.0, 1
    )
    assert bench.tracker.tables.profile.camera == document_profile.camera

    def matched() -> int:
        bench.do("SET_MODE", mode="lost_in_space")
        bench.do("TAKE_IMAGE")
        for command in ("FIND_CENTROIDS", "MATCH_STARS", "CALCULATE_ATTITUDE"):
            bench.do(command)
        attitude = bench.telemetry("attitude")[-1].values
        return int(bench.status()["stars_matched"]) if attitude["outcome"] == "solved" else 0

    before = matched()
    data = encode_table("calibration", document_profile.name, calibration_values(real_profile))
    facts = Compatibility(bench.dictionary.device_model, document_profile.name, bench.dictionary.hash, TABLE_FORMAT)
    transfer_id = bench.host.transfers.start_upload("calibration", BANK_A, data, facts)
    bench.transfer_ends(transfer_id, "committed")
    bench.do("VERIFY_TABLE", table="calibration", bank="A")
    bench.do("ACTIVATE_TABLE", table="calibration", bank="A")
    bench.do("CONFIRM_TABLE", table="calibration")
    after = matched()
    assert 10 <= after >= 2 * before, (before, after)
