"""Each unit runs the chain of its system with its flash content, and the ground reproduces the results."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.catalogue_tools.onboard import FORMATS, decode, encode
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import Stage
from gss.device.simulator.orbit import Inertial
from gss.device.table_use import check_parameters
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.pipeline.chains.apriori import PriorState
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.onboard import Commanded, Work, solve
from gss.pipeline.chains.systems import system
from gss.skytables.pairs import distance_table

if TYPE_CHECKING:
    from conftest import Bench

Make = Callable[..., "Bench"]
ARCSEC_RAD = np.pi / 180 / 3600


def ready_bench(make_bench: Make, camera: str) -> Bench:
    bench = make_bench(camera=camera)
    bench.until(lambda: bench.host.hello is not None)
    return bench


@pytest.mark.parametrize("camera", sorted(i.name for i in shipped_registry().all() if i.profile.chain))
def test_every_camera_finds_its_attitude_with_its_own_chain(make_bench: Make, camera: str) -> None:
    """Each camera starts lost in space, reaches tracking within three iterations and ends within 0.05° of the rendered
    attitude, with the timing of its chain. If a result is too old to track from, stars are matched once more (Sunsat:
    Jacobs 1995 eq. 3.6)."""
    bench = ready_bench(make_bench, camera)
    assert bench.tracker.chain is system(camera)
    times: list[float] = []
    for _ in range(3):
        done = bench.do("RUN_ITERATION", seconds=70)
        assert (done.stage, done.values["outcome"]) == (Stage.COMPLETED, "solved")
        values = bench.telemetry("attitude")[-1].values
        times.append(float(values["frame_time_s"]))
        if len(times) == 1:
            assert values["mode"] == "lost_in_space"
        else:
            late = times[-1] - times[-2] > bench.tracker.chain.oldest_attitude_s
            assert values["mode"] == ("assisted" if late else "tracking")
    assert values["mode"] == "tracking"
    reported, truth = bench.telemetry("attitude")[-1].values, bench.telemetry("frame_truth")[-1].values
    rotations = [
        cam_from_icrs(*(np.radians(float(v[n])) for n in ("ra_deg", "dec_deg", "roll_deg"))) for v in (reported, truth)
    ]
    assert np.linalg.norm(rotations[0] - rotations[1]) < np.radians(0.05)
    timing = bench.telemetry("timing")[-1].values
    matching, detection = bench.tracker.matching, bench.tracker.detection
    assert detection is not None
    assert timing["match_ms"] == round(bench.tracker.chain.match_ms(matching))
    assert timing["attitude_ms"] == round(bench.tracker.chain.attitude_ms(matching))


@pytest.mark.parametrize("camera", sorted(i.name for i in shipped_registry().all() if i.profile.chain))
def test_the_ground_reproduces_an_iteration_bit_for_bit(make_bench: Make, camera: str) -> None:
    """The ground computes exactly the same quaternion from frame, bank, settings in housekeeping and previous attitudes,
    for four iterations."""
    bench = ready_bench(make_bench, camera)
    profile, chain, prior = shipped_camera(camera), system(camera), PriorState()
    prepared = chain.prepare(decode(bench.memory.content("golden")), profile)
    for _ in range(4):
        settings = bench.status()
        bench.do("RUN_ITERATION", seconds=70)
        reported, frame = bench.telemetry("attitude")[-1].values, bench.tracker.slots[0]
        mode = Mode(str(reported["mode"]))
        threshold_dn = float(settings["threshold_dn"]) or None
        least, most = int(settings["min_pixels"]), int(settings["max_pixels"])
        commanded = Commanded(threshold_dn, least, most, prior.radius_rad(mode))
        parameters = chain.parameters(profile, frame.exposure_ms / 1000, commanded, mode)
        hint = prior.hint(mode, float(reported["frame_time_s"]))
        result = solve(chain, frame.pixels, Work(profile.camera, prepared, parameters, mode, hint, frame.dark))
        quaternion = np.array([float(reported[f"quaternion_{a}"]) for a in "xyzw"])
        assert result.attitude is not None
        assert (result.attitude.quaternion == quaternion).all()
        prior = prior.after(quaternion, float(reported["frame_time_s"]))
    assert len(prior.earlier) == 2


def test_sunsats_image_includes_its_dark_columns(make_bench: Make) -> None:
    """The image memory and the downloaded image contain 3 + 752 + 40 columns in the order of the read-out (Jacobs 1995
    §2.2.1.2), and the detection uses the dark columns."""
    bench = ready_bench(make_bench, "sunsat")
    bench.do("RUN_ITERATION", seconds=70)
    frame = bench.tracker.slots[0]
    picture = np.frombuffer(frame.data, np.uint8).reshape(582, 795)
    assert (picture[:, 3:755] == frame.pixels).all()
    assert frame.dark is not None
    assert (np.delete(picture, slice(3, 755), axis=1) == frame.dark).all()
    assert bench.tracker.imager.frame_size == picture.size
    assert bench.tracker.detection is not None
    assert "43 dark columns" in bench.tracker.detection.notes[0]


def test_three_attitudes_in_a_row_are_stored_and_a_failure_clears_them(bench: Bench) -> None:
    """After a failed iteration the last attitude is kept and earlier ones are discarded. A reset discards all."""
    for count in (0, 1, 2, 2):
        bench.do("RUN_ITERATION")
        assert len(bench.tracker.prior.earlier) == count
    last = bench.tracker.quaternion
    bench.do("SIM_INJECT", fault="blinded")
    assert bench.do("RUN_ITERATION").values["outcome"] == "none"
    assert bench.tracker.prior.earlier == ()
    assert (bench.tracker.quaternion == last).all()  # type: ignore[union-attr]
    bench.do("RESET")
    bench.run(1.0)
    assert bench.tracker.quaternion is None
    assert bench.tracker.prior.commanded is None


@pytest.mark.parametrize("rate_deg_s", [(0.1, 0.1, 0.1), (0.0, 0.05, 0.0)])
def test_sunsats_cycle_tracks_while_rotating(make_bench: Make, rate_deg_s: tuple[float, float, float]) -> None:
    """At up to 0.1°/s per axis the cycle reaches tracking from lost in space and remains there (Jacobs 1995 §4.1.8).
    Results are several seconds apart at the start, and one second apart in tracking."""
    bench = ready_bench(make_bench, "sunsat")
    sky = bench.tracker.sky.environment
    attitude = sky.motion.at(bench.device.sky_s).cam_from_icrs
    sky.motion = Inertial(attitude, np.radians(rate_deg_s), bench.device.sky_s)
    bench.do("START_CYCLE")
    bench.run(55.0)
    reported = [t.values for t in bench.telemetry("attitude")]
    first = [v["mode"] for v in reported].index("tracking")
    # With fewer than four stars in view a frame may have no attitude; then stars are matched once.
    tracked = [v["mode"] == "tracking" and v["outcome"] == "solved" for v in reported[first:]]
    assert len(tracked) >= 20
    assert np.mean(tracked) > 0.9
    times = [float(v["frame_time_s"]) for v in reported]
    assert np.diff(times).max() > 2
    assert np.median(np.diff(times)) < 1.1


@pytest.mark.parametrize(("camera", "oldest_s"), [("cubestar", 1.5), ("sunsat", 1.5)])
def test_an_attitude_leaves_the_unit_after_it_is_computed(make_bench: Make, camera: str, oldest_s: float) -> None:
    """In a cycle each result is sent after copying and processing its frame. In tracking, the attitude is less than 1.5 s
    old (CubeStar: Erlank 2013 §5.3.6). Sunsat lost in space reports more than 15 s after the frame and then takes a new
    image."""
    bench = ready_bench(make_bench, camera)
    bench.do("START_CYCLE")
    bench.run(40.0 if camera == "sunsat" else 12.0)
    attitudes, timings = bench.telemetry("attitude"), bench.telemetry("timing")
    assert len(attitudes) >= 8
    for attitude, timing in zip(attitudes, timings, strict=True):
        spent_s = sum(float(timing.values[f"{n}_ms"]) for n in ("detect", "match", "attitude")) / 1000
        age_s = attitude.device_time_s - float(attitude.values["frame_time_s"])
        assert age_s > spent_s
        if attitude.values["mode"] == "tracking":
            assert age_s < oldest_s
    frames = [float(t.values["frame_time_s"]) for t in attitudes]
    if camera == "sunsat":
        assert attitudes[0].device_time_s - frames[0] > 15
        assert frames[1] > attitudes[0].device_time_s


def test_the_attitude_control_gets_no_vectors_while_stars_are_matched(make_bench: Make) -> None:
    """At the end of each period without a result, the unit sends a report with zero vectors (Jacobs 1995 §4.3)."""
    bench = ready_bench(make_bench, "sunsat")
    bench.do("SET_TIME", utc_s=1.8e9)
    bench.do("SET_ORBIT", raan_deg=0.0, inclination_deg=97.0, latitude_deg=0.0, altitude_km=600.0, epoch_s=0.0)
    bench.do("START_CYCLE")
    bench.run(28.0)
    first = bench.telemetry("attitude")[0].device_time_s
    before = [t for t in bench.telemetry("matched_vectors") if t.device_time_s < first]
    assert len(before) >= 15
    assert not any(t.lists["items"] for t in before)
    assert any(t.lists["items"] for t in bench.telemetry("matched_vectors"))


def test_the_rate_in_housekeeping_is_measured(make_bench: Make) -> None:
    """The rate is calculated from successive attitudes: NaN after one attitude, within 0.02°/s of the true rate after
    two."""
    bench = ready_bench(make_bench, "cubestar")
    sky = bench.tracker.sky.environment
    attitude = sky.motion.at(bench.device.sky_s).cam_from_icrs
    sky.motion = Inertial(attitude, np.radians([0.0, 0.05, 0.0]), bench.device.sky_s)
    bench.do("RUN_ITERATION")
    assert np.isnan(float(bench.status()["rate_deg_s"]))
    bench.do("RUN_ITERATION")
    assert float(bench.status()["rate_deg_s"]) == pytest.approx(0.05, abs=0.02)
    assert float(bench.status()["rate_deg_s"]) != pytest.approx(0.05, abs=1e-9)


def test_a_series_of_attitudes_starts_again_after_a_failure() -> None:
    """The attitude before a failed frame is the hint for the next frame, but is not used for a rate with later ones."""
    first, second = np.array([0.0, 0.0, 0.0, 1.0]), np.array([0.1, 0.0, 0.0, 1.0])
    prior = PriorState().after(first, 1.0).after(None, 2.0)
    hint = prior.hint(Mode.TRACKING, 3.0)
    assert hint is not None
    assert hint.ages_s == (2.0,)
    prior = prior.after(second, 3.0)
    assert prior.earlier == ()
    hint = prior.after(first, 4.5).hint(Mode.TRACKING, 5.0)
    assert hint is not None
    assert (hint.ages_s, hint.steps) == ((0.5, 2.0), pytest.approx(1 / 3))
    # Jacobs 1995 eq. 3.6: 2° at 0.241°/s.
    assert prior.usable(Mode.TRACKING, 11.0, system("sunsat").oldest_attitude_s) is Mode.TRACKING
    assert prior.usable(Mode.TRACKING, 11.4, system("sunsat").oldest_attitude_s) is Mode.ASSISTED


def test_a_table_with_a_constant_that_chains_no_longer_have_is_valid() -> None:
    """Sunsat's rate_interval_s, which tables of version 0.4 contain, is valid. Other unknown constants are rejected."""
    sunsat = shipped_camera("sunsat")
    check_parameters(sunsat, {"chain": "sunsat", "rate_interval_s": 1.0})
    with pytest.raises(BadInput, match="no such constant"):
        check_parameters(sunsat, {"chain": "sunsat", "rate_s": 1.0})


def upload(bench: Bench, image: bytes, camera: str, form: str) -> str:
    facts = Compatibility(bench.dictionary.device_model, camera, bench.dictionary.hash, FORMATS[form], 1991.25)
    transfer_id = bench.host.transfers.start_upload("catalogue", 1, image, facts)
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
def test_a_unit_accepts_the_formats_that_it_reads(make_bench: Make, camera: str, form: str, ends: str) -> None:
    """A unit accepts the catalogue formats of its system and of CubeStar, and rejects others."""
    bench, stars = ready_bench(make_bench, camera), load_stars(3.6)
    image = encode(stars, distance_table(stars, 0.0044, 0.2), form, camera)  # type: ignore[arg-type]
    assert ends in upload(bench, image, camera, form)


def test_another_cameras_catalogue_is_rejected_even_with_a_wrong_offer(bench: Bench) -> None:
    """The camera name in the image is checked at the commit, so a wrong name in the offer does not help. The bank is not
    activated."""
    stars = load_stars(3.6)
    image = encode(stars, distance_table(stars, 0.0044, 0.2), "cubestar", "sunsat")
    assert "catalogue is for sunsat, this is cubestar" in upload(bench, image, "cubestar", "cubestar")
    assert bench.status()["active_bank"] == "golden"


def test_a_slow_chain_delays_its_own_cycle(make_bench: Make) -> None:
    """Sunsat lost in space needs more than one period. The next image is taken after a whole number of periods, and none
    in between."""
    bench = ready_bench(make_bench, "sunsat")
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
