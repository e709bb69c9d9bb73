"""Replay by stages: the chain of each system compared with its sensor's packets, and each possible difference."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.device.simulator.reports import attitude_report, centroid_report, match_report
from gss.domain.angles import ra_dec_from_unit
from gss.domain.camera_profile import CameraProfile
from gss.domain.frames import cam_from_icrs
from gss.domain.results import SolveResult
from gss.instruments.registry import shipped_camera
from gss.operations.frames.onboard_reported import record_from, reported_of
from gss.operations.frames.onboard_results import OnboardRecord
from gss.operations.frames.replay import ReplayService, Shelf
from gss.operations.frames.replay_stages import ReplayStage, Rerun, StageVerdict, first_difference, stages
from gss.operations.frames.solver_cache import SolverCache
from gss.pipeline.chains.apriori import Apriori, KnownOrbit, PriorState, TimedAttitude
from gss.pipeline.chains.modes import AttitudePrior, Mode
from gss.pipeline.chains.onboard import Commanded, Work, solve
from gss.pipeline.chains.systems import SYSTEMS, system
from gss.pipeline.render import render
from gss.pipeline.trace import Trace
from gss.store.models import Frame
from validation.never_wrong.lists import OWN, setting_of
from validation.never_wrong.sky import works_of

STARS = load_stars(8.0)
# Where each camera detects enough stars.
ATTITUDES = {name: cam_from_icrs(1.4, 0.05, 0.3) for name in SYSTEMS} | {"aim": cam_from_icrs(0.98, 0.42, 0.3)}


def _single(values: dict[str, Any]) -> dict[str, Any]:
    """Return the values as sent: all reals except quaternion components are rounded to single precision."""
    return {
        k: float(np.float32(v)) if isinstance(v, float) and not k.startswith("quaternion") else v
        for k, v in values.items()
    }


def _run(name: str, change: Callable[[Work], Work] = lambda w: w) -> tuple[Rerun, Work]:
    known = shipped_camera(name)
    rng = np.random.default_rng(12)
    attitude = ATTITUDES[name]
    frame = render(STARS, known.camera, known.sensor, attitude, known.sensor.exposure_s, rng)
    work, chain, trace = change(_work(name)), system(name), Trace()
    result = solve(chain, frame.pixels, work, trace=trace)
    intermediates: dict[str, Any] = trace.kept
    return Rerun(result, intermediates["detection"], intermediates["matching"]), work


@lru_cache(maxsize=8)
def _work(name: str) -> Work:
    return works_of(setting_of(name, OWN), shipped_camera(name), STARS)[Mode.LOST_IN_SPACE]


@lru_cache(maxsize=8)
def _equal_run(name: str) -> tuple[OnboardRecord, Rerun]:
    """Return the unit's packets of a frame as received, and the ground's run of the same frame."""
    rerun, work = _run(name)
    return _sent(rerun, work), rerun


def _sent(rerun: Rerun, work: Work) -> OnboardRecord:
    detection, matching, result = rerun.detection, rerun.matching, rerun.result
    assert detection is not None
    _, values, lists = centroid_report(5, detection)
    _, _, match_lists = match_report(5, matching)
    _, sent_attitude, _ = attitude_report({"frame_number": 5, "mode": str(work.mode)}, result.attitude, result.reason)
    record = OnboardRecord(5).with_packet("centroids", _single(values), [_single(r) for r in lists["items"]])
    record = record.with_packet("matches", {}, [_single(r) for r in match_lists["items"]])
    return record.with_packet("attitude", _single(sent_attitude), ())


def _verdicts(found: list[ReplayStage]) -> dict[str, StageVerdict]:
    return {s.name: s.verdict for s in found}


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_every_system_replays_equal(name: str) -> None:
    """A replay equals the packets of a unit with this chain in every stage, except for values that are never sent."""
    record, rerun = _equal_run(name)
    replayed = stages(record, rerun)
    assert first_difference(replayed) == "equal"
    assert rerun.result.attitude is not None, rerun.result.reason
    assert [s.name for s in replayed if s.verdict is not StageVerdict.EQUAL] == ["unit vectors"]


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_another_threshold_differs_first_in_detection(name: str) -> None:
    """With another threshold than on board the first difference is in detection, not in matching or attitude."""
    record, _ = _equal_run(name)

    def higher(work: Work) -> Work:
        known = shipped_camera(name)
        own = system(name).parameters(known, None, Commanded(), work.mode)
        threshold_dn = 1.7 * (own.threshold_dn or 30.0)  # far_mst calculates it from the noise
        other = system(name).parameters(known, None, Commanded(threshold_dn=threshold_dn), work.mode)
        return replace(work, parameters=other)

    replayed = stages(record, _run(name, higher)[0])
    first = next(s for s in replayed if s.verdict is StageVerdict.DIFFERS)
    assert first.name in ("regions rejected", "centroids", "places", "light")
    assert first.difference == first_difference(replayed) != "equal"


def test_a_bank_is_prepared_again_for_a_replaced_package() -> None:
    """The last prepared bank is used again only for the same camera and sensor, not for those of another package with the
    same name."""
    name = "sunsat"
    known = shipped_camera(name)
    bank = SolverCache(STARS.brighter_than(4.0)).bank(known, 2027.0)
    service = ReplayService(*[cast(Any, None)] * 4, time.perf_counter)

    def prepared(profile: CameraProfile) -> Any:
        return service._prepared(Shelf(profile, system(name), {}, None, np.zeros((0, 2), np.intp), ()), "0", bank)

    first = prepared(known)
    assert prepared(replace(known, title="another text")) is first
    assert prepared(replace(known, camera=known.camera.with_focal_scaled(1.01))) is not first
    other = prepared(known)
    assert prepared(replace(known, sensor=replace(known.sensor, faint_limit_mag=3.0))) is not other
    service.stop()


def test_two_replays_at_once_have_their_own_banks() -> None:
    """If another replay prepares its bank at the same time, each replay has the bank of its frame."""
    known = shipped_camera("sunsat")
    chain = SimpleNamespace(name="sunsat", prepare=lambda bank, profile: bank)
    shelf = Shelf(known, cast(Any, chain), {}, None, np.zeros((0, 2), np.intp), ())

    class Interrupted(ReplayService):
        """Service in which another replay runs immediately after the first bank was prepared."""

        def __setattr__(self, name: str, value: Any) -> None:
            super().__setattr__(name, value)
            if name == "_last_prepared" and value is not None and value[1] == "first":
                self._prepared(shelf, "2", cast(Any, "second"))

    service = Interrupted(*[cast(Any, None)] * 4, time.perf_counter)
    assert service._prepared(shelf, "1", cast(Any, "first")) == "first"
    assert service._prepared(shelf, "2", cast(Any, "second")) == "second"
    service.stop()


def test_another_bank_differs_first_in_the_matches() -> None:
    """With another bank, centroids are equal and the first difference is in the matches."""
    record, _ = _equal_run("cubestar")

    def other_bank(work: Work) -> Work:
        setting = replace(setting_of("cubestar", OWN), bank_mag=3.4)
        return replace(work, catalogue=works_of(setting, shipped_camera("cubestar"), STARS)[work.mode].catalogue)

    replayed = stages(record, _run("cubestar", other_bank)[0])
    first = next(s for s in replayed if s.verdict is StageVerdict.DIFFERS)
    assert first.name == "matches"
    assert "on board" in first.difference
    assert _verdicts(replayed)["places"] is StageVerdict.EQUAL


def _with_difference(record: OnboardRecord, stage: str) -> OnboardRecord:
    rows, matches, sent_attitude = (
        [dict(r) for r in record.centroids],
        [dict(r) for r in record.matches],
        dict(record.attitude or {}),
    )
    detected = dict(record.detected)
    if stage == "regions rejected":
        detected["regions_invalid"] += 1
    elif stage == "black level":
        detected["background_dn"] += 0.01
    elif stage == "centroids":
        rows.pop()
    elif stage == "places":
        rows[2]["row_px"] += 0.001
    elif stage == "light":
        rows[1]["flux_dn"] *= 1.001
    elif stage == "matches":
        matches[0]["star"] += 1
    elif stage == "weights":
        matches[1]["weight"] += 1.0
    elif stage == "mode":
        sent_attitude["mode"] = "tracking"
    elif stage == "outcome":
        sent_attitude |= {"outcome": "none", "reason": "no"}
    elif stage == "quaternion":
        sent_attitude["quaternion_x"] += 1e-9
    elif stage == "standard deviations":
        sent_attitude["sigma_cross_arcsec"] *= 1.01
    return replace(record, centroids=rows, matches=matches, attitude=sent_attitude, detected=detected)


STAGES = (
    *("regions rejected", "black level", "centroids", "places", "light"),
    *("matches", "weights", "mode", "outcome", "quaternion", "standard deviations"),
)


@pytest.mark.parametrize("stage", STAGES)
def test_each_stage_is_reported_if_it_differs_first(stage: str) -> None:
    """A difference injected into one stage is reported there first, with both values."""
    record, rerun = _equal_run("cubestar")
    replayed = stages(_with_difference(record, stage), rerun)
    first = next(s for s in replayed if s.verdict is StageVerdict.DIFFERS)
    assert first.name == stage
    assert first.on_board != first.ground
    if stage == "places":
        assert first.difference_px == pytest.approx(0.001, rel=0.1)
        assert first.difference_arcsec == pytest.approx(0.001 * 183.9, rel=0.1)  # 5.6 µm at 6.28 mm
    if stage == "quaternion":
        assert first.difference_arcsec == pytest.approx(2e-9 * 206265, rel=1.0)


def test_missing_packets_are_reported_as_not_sent() -> None:
    """Without the attitude packet and the packet's header those stages are not sent, which is not a difference."""
    record, rerun = _equal_run("cubestar")
    replayed = stages(replace(record, attitude=None, detected={}), rerun)
    verdicts = _verdicts(replayed)
    for name in ("regions rejected", "black level", "unit vectors", "mode", "outcome", "quaternion"):
        assert verdicts[name] is StageVerdict.NOT_SENT, name
    assert first_difference(replayed) == "equal"


def test_a_result_without_intermediates_is_compared_as_far_as_possible() -> None:
    """With a result without intermediates, only the number of matches is compared."""
    record, rerun = _equal_run("cubestar")
    bare: SolveResult = rerun.result
    verdicts = _verdicts(stages(record, Rerun(bare)))
    assert verdicts["matches"] is StageVerdict.EQUAL
    assert verdicts["weights"] is StageVerdict.NOT_COMPARED


def test_the_onboard_record_survives_the_store() -> None:
    """A record, including the prior of its frame, is read unchanged from the store. Records of version 0.4 can be read."""
    record, rerun = _equal_run("cubestar")
    quaternion = np.array([0.1, 0.2, 0.3, math.sqrt(0.86)])
    orbit, apriori = KnownOrbit(1.0, 1.7, 0.2, 6e5, 100.0), Apriori(0.0, 0.1, 0.2, 0.09)
    series = (TimedAttitude(quaternion, 8.5), TimedAttitude(quaternion, math.nan))
    prior = PriorState(series, True, None, 0.05, orbit, apriori)
    frame = Frame(number=5, profile="cubestar", exposure_s=0.25, bank_sha256="ab", parameters={"threshold_dn": 13})
    stored = reported_of(replace(record, prior=prior), frame)
    restored = record_from(stored)
    assert first_difference(stages(restored, rerun)) == "equal"
    hint = restored.prior.hint(Mode.TRACKING, 0.0)
    assert hint is not None
    assert np.allclose(hint.boresight_icrs, AttitudePrior.from_quaternion(quaternion).boresight_icrs)
    assert (restored.prior.orbit, restored.prior.apriori) == (prior.orbit, prior.apriori)
    assert [a.time_s for a in restored.prior.series] == pytest.approx([8.5, math.nan], nan_ok=True)
    assert restored.prior.failed
    # Results of version 0.4 have attitudes without times.
    listed = {**stored["prior"], "quaternion": quaternion.tolist(), "earlier": [quaternion.tolist()]}
    del listed["series"], listed["failed"]
    old = record_from({**stored, "prior": listed}).prior.hint(Mode.TRACKING, 9.0)
    assert old is not None
    assert (len(old.earlier), old.ages_s) == (1, (1.0, 2.0))
    assert ra_dec_from_unit(hint.boresight_icrs)[1] is not None
    assert stored["frame"]["parameters"] == {"threshold_dn": 13}
