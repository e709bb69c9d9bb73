"""Each camera's unit runs its own system's chain from what is in its flash, and the ground can repeat it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.catalogue_tools.onboard import FORMATS, decode, encode
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.catalogue_tools.tables.distances import distance_table
from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import Stage
from gss.domain.frames import cam_from_icrs
from gss.domain.profiles import PROFILES, profile
from gss.pipeline.chains.apriori import Known
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.onboard import Commanded, Work, solve
from gss.pipeline.chains.systems import on_board

if TYPE_CHECKING:
    from conftest import Bench

Make = Callable[..., "Bench"]
ARCSEC_RAD = np.pi / 180 / 3600


def greeted(make_bench: Make, camera: str) -> Bench:
    bench = make_bench(camera=camera)
    bench.until(lambda: bench.host.hello is not None)
    return bench


@pytest.mark.parametrize("camera", sorted(PROFILES))
def test_every_camera_finds_its_attitude_with_its_own_chain(make_bench: Make, camera: str) -> None:
    """Lost in space first, then tracking, each within 0.05° of where the sky was drawn; timing is the chain's."""
    bench = greeted(make_bench, camera)
    assert bench.tracker.chain is on_board(camera)
    for mode in ("lost_in_space", "tracking"):
        done = bench.do("RUN_ITERATION", seconds=70)
        assert (done.stage, done.values["outcome"]) == (Stage.COMPLETED, "solved")
        assert bench.telemetry("attitude")[-1].values["mode"] == mode
    told, truth = bench.telemetry("attitude")[-1].values, bench.telemetry("frame_truth")[-1].values
    rotations = [
        cam_from_icrs(*(np.radians(float(v[n])) for n in ("ra_deg", "dec_deg", "roll_deg"))) for v in (told, truth)
    ]
    assert np.linalg.norm(rotations[0] - rotations[1]) < np.radians(0.05)
    timing = bench.telemetry("timing")[-1].values
    matching, detection = bench.tracker.matching, bench.tracker.detection
    assert detection is not None
    assert timing["match_ms"] == round(bench.tracker.chain.match_ms(matching))
    assert timing["attitude_ms"] == round(bench.tracker.chain.attitude_ms(matching))


@pytest.mark.parametrize("camera", sorted(PROFILES))
def test_the_ground_repeats_an_iteration_bit_for_bit(make_bench: Make, camera: str) -> None:
    """Frame, bank, settings of housekeeping and the attitudes told before lead to the very same quaternion, four in a row."""
    bench = greeted(make_bench, camera)
    own, chain, known = profile(camera), on_board(camera), Known()
    prepared = chain.prepare(decode(bench.memory.content("golden")), own)
    for _ in range(4):
        settings = bench.status()
        bench.do("RUN_ITERATION", seconds=70)
        told, frame = bench.telemetry("attitude")[-1].values, bench.tracker.slots[0]
        mode = Mode(str(told["mode"]))
        threshold_dn = float(settings["threshold_dn"]) or None
        least, most = int(settings["min_pixels"]), int(settings["max_pixels"])
        commanded = Commanded(threshold_dn, least, most, known.radius_rad(mode))
        parameters = chain.parameters(own, frame.exposure_ms / 1000, commanded, mode)
        hint = known.hint(mode, float(told["frame_time_s"]))
        result = solve(chain, frame.pixels, Work(own.camera, prepared, parameters, mode, hint))
        quaternion = np.array([float(told[f"quaternion_{a}"]) for a in "xyzw"])
        assert result.attitude is not None
        assert (result.attitude.quaternion == quaternion).all()
        known = known.after(quaternion)
    assert len(known.earlier) == 2


def test_three_attitudes_in_a_row_are_remembered_and_a_failure_breaks_the_row(bench: Bench) -> None:
    """The last attitude stays known, the ones before it are forgotten when an iteration finds none."""
    for count in (0, 1, 2, 2):
        bench.do("RUN_ITERATION")
        assert len(bench.tracker.known.earlier) == count
    last = bench.tracker.quaternion
    bench.do("SIM_INJECT", fault="blinded")
    assert bench.do("RUN_ITERATION").values["outcome"] == "none"
    assert bench.tracker.known.earlier == ()
    assert (bench.tracker.quaternion == last).all()  # type: ignore[union-attr]
    bench.do("RESET")
    bench.run(1.0)
    assert bench.tracker.quaternion is None
    assert bench.tracker.known.commanded is None


def upload(bench: Bench, image: bytes, camera: str, form: str) -> str:
    facts = Compatibility(bench.dictionary.device_model, camera, bench.dictionary.hash, FORMATS[form], 1991.25)
    transfer_id = bench.host.start_upload("catalogue", 1, image, facts, bench.now_s)
    bench.until(lambda: bench.host.transfer(transfer_id).state in ("committed", "failed", "aborted"), 60.0)
    return f"{bench.host.transfer(transfer_id).state} {bench.host.transfer(transfer_id).reason}"


@pytest.mark.parametrize(
    ("camera", "form", "ends"),
    [
        ("sunsat", "sunsat", "committed"),
        ("sunsat", "cubestar", "committed"),
        ("cubestar", "cubestar", "committed"),
        ("cubestar", "sunsat", "format_version: expected 1, got 2"),
    ],
)
def test_a_unit_takes_the_formats_that_it_reads(make_bench: Make, camera: str, form: str, ends: str) -> None:
    """Its own system's and CubeStar's, no other."""
    bench, stars = greeted(make_bench, camera), load_stars(3.6)
    image = encode(stars, distance_table(stars, 0.0044, 0.2), form, camera)  # type: ignore[arg-type]
    assert ends in upload(bench, image, camera, form)


def test_another_cameras_catalogue_is_refused_even_if_the_offer_lies(bench: Bench) -> None:
    """The name in the image counts, not the name in the offer: refused at the commit, and nothing is activated."""
    stars = load_stars(3.6)
    image = encode(stars, distance_table(stars, 0.0044, 0.2), "cubestar", "sunsat")
    assert "catalogue is for sunsat, this is cubestar" in upload(bench, image, "cubestar", "cubestar")
    assert bench.status()["active_bank"] == "golden"


def test_a_slow_chain_delays_its_own_cycle(make_bench: Make) -> None:
    """Sunsat lost in space needs more than a period: the next image is late by whole periods, and none is taken meanwhile."""
    bench = greeted(make_bench, "sunsat")
    bench.do("START_CYCLE")
    bench.run(40.0)
    infos = [t.values for t in bench.telemetry("frame_info")]
    gaps = np.diff([float(i["frame_time_s"]) for i in infos])
    needed = [
        sum(float(t.values[f"{n}_ms"]) for n in ("detect", "match", "attitude")) for t in bench.telemetry("timing")
    ]
    assert max(needed) > 5000
    assert gaps.max() >= np.ceil(max(needed) / 1000) - 1.01
    assert np.allclose(gaps, np.rint(gaps), atol=0.02)
