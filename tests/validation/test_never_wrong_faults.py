"""The campaign that hunts for false attitudes: its faults do what they say, and its shards can be made again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.modes import Mode
from validation.never_wrong.faults import FAULTS, Fault, FieldLocation, attitude_at
from validation.never_wrong.frames import FRAME_FAULTS, FrameCampaign, FrameShard, faulty_frame
from validation.never_wrong.lists import CAMERAS, Campaign, Shard, setting_of, shards
from validation.never_wrong.sky import SETTINGS, Subject, shown, subject
from validation.never_wrong.table import judge, judge_with

STARS = load_stars(7.0)
CUBESTAR = SETTINGS[0]


def _subject() -> Subject:
    return subject(CUBESTAR, STARS)


def test_every_fault_of_the_requirement_is_there() -> None:
    """False stars by number, missing, planets, doubles, variables, magnitudes, focal length, mirror, other camera, pole, RA 0."""
    assert {0, 1, 5, 10, 100} <= {f.false for f in FAULTS}
    assert {0.5, -0.5} <= {f.shift_mag for f in FAULTS}
    assert {1.01, 0.99} <= {f.scale for f in FAULTS}
    for field in ("missing", "planets", "blended", "variable", "off_mag", "saturated", "mirrored", "another"):
        assert any(getattr(f, field) for f in FAULTS), field
    assert {FieldLocation.POLE, FieldLocation.ZERO_RA} <= {f.place for f in FAULTS}
    assert any(f.starless for f in FRAME_FAULTS)
    assert any(f.flat == 1.0 for f in FRAME_FAULTS)


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("place", [FieldLocation.POLE, FieldLocation.ZERO_RA])
def test_a_field_lies_where_its_fault_says(camera: str, place: FieldLocation) -> None:
    """The pole, or a point of the meridian of RA 0, is on the detector."""
    rng, known = np.random.default_rng(3), shipped_camera(camera).camera
    for _ in range(20):
        attitude = attitude_at(place, known, rng)
        if place is FieldLocation.POLE:
            points = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
        else:
            dec = np.radians(np.linspace(-90, 90, 2000))
            points = np.stack([np.cos(dec), np.zeros_like(dec), np.sin(dec)], axis=1)
        ahead = points @ attitude.T
        ahead = ahead[ahead[:, 2] > np.cos(known.half_diagonal_rad)]
        assert known.contains(known.project(ahead)).any()


@pytest.mark.parametrize(
    ("fault", "more"),
    [(Fault("x", planets=3), 3), (Fault("x", false=7), 7), (Fault("x", missing=1.0, false=2), None)],
)
def test_strangers_are_added(fault: Fault, more: int | None) -> None:
    """A list has as many points more as the fault has planets and false stars; planets are the brightest."""
    tested, attitude = _subject(), attitude_at(FieldLocation.ANYWHERE, _subject().camera, np.random.default_rng(1))
    plain = shown(tested, replace(fault, planets=0, false=0), attitude, np.random.default_rng(2)).centroids
    spoiled = shown(tested, fault, attitude, np.random.default_rng(2)).centroids
    assert len(spoiled) - len(plain) == (2 if more is None else more)
    if fault.planets:
        assert spoiled.flux_dn[2] > plain.flux_dn[0]


def test_another_camera_gives_its_own_places() -> None:
    """What another focal length saw lies elsewhere, and on the detector that is believed in."""
    tested, attitude = _subject(), attitude_at(FieldLocation.ANYWHERE, _subject().camera, np.random.default_rng(1))
    made = shown(tested, Fault("x", another=True), attitude, np.random.default_rng(2))
    own = shown(tested, Fault("x"), attitude, np.random.default_rng(2))
    assert tested.camera.contains(made.centroids.pixels).all()
    assert len(made.centroids) != len(own.centroids)


@pytest.mark.parametrize("fault", range(len(FAULTS)))
def test_cubestar_never_answers_wrongly(fault: int) -> None:
    """Four attitudes of each fault and mode: no wrong answer."""
    tested = _subject()
    for mode in range(3):
        for trial in range(4):
            assert judge(tested, FAULTS[fault], (21, 0, fault, mode), trial).verdict.value != "wrong"


def test_a_shard_is_the_same_again_and_shares_its_lists() -> None:
    """The same shard gives the same verdicts; own chain and reference are tested equally often, with the same faults
    and modes.
    """
    campaign = Campaign(STARS)
    first, again = (campaign.run(Shard("cubestar", "own", 4, 0)) for _ in range(2))
    assert first == again
    assert sum(first.counts.values()) == 250
    assert not first.wrong
    assert setting_of("cubestar", "reference").camera == "cubestar"
    assert len(shards(501, 1, ("cubestar", "aim"))) == 3 * 2 * 2


def test_frames_are_spoilt_and_judged() -> None:
    """One frame of each fault: blank, flat, mirrored and foreign frames have no answer, the plain one has; sizes fit."""
    known = shipped_camera("cubestar")
    verdicts = FrameCampaign(STARS).run(FrameShard("cubestar", "own", 2, 1))
    by_fault = {FRAME_FAULTS[j].title: verdict for (j, _, verdict) in verdicts.counts}
    assert not verdicts.wrong
    for title in ("frame, blank", "frame, full scale everywhere", "frame, mirrored", "frame, another camera"):
        assert by_fault[title] == "none"
    assert by_fault["frame, no fault"] in ("correct", "imprecise")
    for fault in FRAME_FAULTS:
        rng = np.random.default_rng(5)
        pixels, _ = faulty_frame(fault, known, STARS, attitude_at(fault.place, known.camera, rng), rng)
        assert pixels.shape == (known.camera.rows, known.camera.columns)


@pytest.mark.parametrize(("camera", "attitude"), [("aim", 4085), ("aim", 5417), ("sunsat", 1784)])
def test_what_the_campaign_once_found_stays_mended(camera: str, attitude: int) -> None:
    """Two stars of a mirrored frame that would turn a tracked attitude, and three in a corner with another focal length."""
    tested = subject(setting_of(camera, "own"), propagate(load_stars(8.0), 2000.0))
    rng = np.random.default_rng([1, 910, CAMERAS.index(camera), attitude])
    share = np.array([f.share for f in FAULTS])
    fault = FAULTS[int(rng.choice(len(FAULTS), p=share / share.sum()))]
    assert fault.mirrored or fault.scale != 1.0
    assert judge_with(tested, fault, list(Mode)[attitude % 3], rng).verdict.value != "wrong"


@pytest.mark.parametrize(("camera", "attitude"), [("far_mst", 3636), ("far_mst", 4299), ("oersted", 3777)])
def test_an_attitude_that_explains_a_quarter_of_the_stars_is_rejected(camera: str, attitude: int) -> None:
    """Lists, mirrored or with false stars, whose best place named 3 of 27 to 11 of 42 stars: the reference answers none."""
    tested = subject(setting_of(camera, "reference"), propagate(load_stars(8.0), 2000.0))
    rng = np.random.default_rng([1, 910, CAMERAS.index(camera), attitude])
    share = np.array([f.share for f in FAULTS])
    fault = FAULTS[int(rng.choice(len(FAULTS), p=share / share.sum()))]
    assert judge_with(tested, fault, list(Mode)[attitude % 3], rng).verdict.value == "none"
