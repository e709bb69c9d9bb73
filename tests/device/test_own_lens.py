"""A simulated unit whose lens differs from its document: the sky is rendered with it, and only a table informs the
unit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.device.protocol.transfer import Compatibility
from gss.device.simulator.__main__ import main
from gss.device.simulator.own_lens import own_lens
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
    """One percent: focal length 1 %, centre 4 px, distortion 3 %; the seed decides the direction, and 0 is the
    document's lens.
    """
    known = shipped_camera(name)
    one, again, other = own_lens(known, 1.0, 5), own_lens(known, 1.0, 5), own_lens(known, 1.0, 6)
    assert one == again
    assert one.camera != other.camera
    assert own_lens(known, 0.0, 5) is known
    assert one.camera.focal_col_px == pytest.approx(1.01 * known.camera.focal_col_px)
    moved = np.hypot(
        one.camera.centre_col_px - known.camera.centre_col_px, one.camera.centre_row_px - known.camera.centre_row_px
    )
    assert moved == pytest.approx(4.0)
    half, whole = (camera_difference(known.camera, own_lens(known, p, 5).camera).rms_px for p in (0.5, 1.0))
    assert whole == pytest.approx(2 * half, rel=0.1)
    if isinstance(known.camera.distortion, RadialTilt):
        assert one.camera.distortion.focal_mm == pytest.approx(one.focal_mm)
    with pytest.raises(BadInput, match="lens error is out of range"):
        own_lens(known, 11.0, 5)


def test_an_impossible_lens_is_rejected_at_the_start(capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 2 and a message, as for other options."""
    assert main(["--instrument", "cubestar", "--pty", "--lens-off", "40"]) == 2
    assert "at most 10 %" in capsys.readouterr().err


def test_the_unit_matches_more_with_the_table_of_its_lens(make_bench: Callable[..., Bench]) -> None:
    """Half a percent off: its own table gives twice the matches of the factory table of the document's lens."""
    bench = make_bench()
    bench.until(lambda: bench.host.hello is not None)
    known: CameraProfile = bench.tracker.profile
    real, plain = own_lens(known, 0.5, 3), bench.tracker.sky
    bench.tracker.imager._sky = bench.tracker.sky = SimulatedSky(real, plain.environment.motion, 2026.0, 1)
    assert bench.tracker.tables.profile.camera == known.camera

    def matched() -> int:
        bench.do("SET_MODE", mode="lost_in_space")
        bench.do("TAKE_IMAGE")
        for command in ("FIND_CENTROIDS", "MATCH_STARS", "CALCULATE_ATTITUDE"):
            bench.do(command)
        said = bench.telemetry("attitude")[-1].values
        return int(bench.status()["stars_matched"]) if said["outcome"] == "solved" else 0

    before = matched()
    data = encode_table("calibration", known.name, calibration_values(real))
    facts = Compatibility(bench.dictionary.device_model, known.name, bench.dictionary.hash, TABLE_FORMAT)
    transfer_id = bench.host.transfers.start_upload("calibration", BANK_A, data, facts)
    bench.transfer_ends(transfer_id, "committed")
    bench.do("VERIFY_TABLE", table="calibration", bank="A")
    bench.do("ACTIVATE_TABLE", table="calibration", bank="A")
    bench.do("CONFIRM_TABLE", table="calibration")
    after = matched()
    assert 10 <= after >= 2 * before, (before, after)
