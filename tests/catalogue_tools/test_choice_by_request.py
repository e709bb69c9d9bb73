"""Options of a request for selecting stars: size estimates, screening list, reduced catalogue and thinning."""

import json
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from gss.catalogue_tools.build import build, prepare, preview
from gss.catalogue_tools.envelope.attitude import AttitudeLimits
from gss.catalogue_tools.onboard import decode
from gss.catalogue_tools.request import BuildRequest, ElementsOrbit, parameters_of, request_from
from gss.catalogue_tools.selection.screening import ScreeningRules, screen
from gss.catalogue_tools.selection.selection import Fate, SelectionRules
from gss.catalogue_tools.selection.uniform_density import survey_attitudes
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.angles import separation_rad
from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_camera
from gss.skytables.bank import ReducedFrame


def deg(*values):
    return tuple(float(np.radians(v)) for v in values)


WHOLE = BuildRequest(shipped_camera("sunsat"), "sunsat", SelectionRules(5.0), pointings=300)
PATCH = replace(
    WHOLE,
    profile=shipped_camera("oersted"),
    format_name="oersted",
    rules=SelectionRules(4.5),
    attitude=AttitudeLimits("inertial", deg(-4, 4), deg(-4, 4), deg(-4, 4), ra_rad=1.4, dec_rad=0.1),
)
BAND = replace(
    WHOLE,
    orbit=ElementsOrbit(deg(97, 97), deg(133, 149)),
    attitude=AttitudeLimits("sunsat", deg(-10, 10), deg(-5, 5), deg(130, 140)),
    start=datetime(2026, 12, 1, tzinfo=UTC),
)


@pytest.fixture(scope="module")
def stars():
    return load_stars()


def test_a_reduced_directory_that_fits_into_the_bank_is_accepted(stars):
    """far-mst to V 6 fits into a bank that the pairs of all stars would exceed, and the preview estimates its size."""
    request = BuildRequest(shipped_camera("far_mst"), "far-mst", SelectionRules(6.0), bank_bytes=600_000, pointings=300)
    assert len(prepare(request, stars).selection.kept) > 5000
    previewed, built = preview(request, stars), build(request, stars)
    assert len(built.image) <= 600_000
    assert previewed.pairs == pytest.approx(len(built.distances), rel=0.05)
    assert previewed.bytes == pytest.approx(len(built.image), rel=0.05)


@pytest.mark.parametrize("profile", ["oersted", "aim"])
@pytest.mark.parametrize("faint_mag", [4.5, 6.0])
def test_the_preview_states_the_size_of_a_small_region(stars, profile, faint_mag):
    """For formats with triplets or links the preview states the size of the image of a small region."""
    request = replace(PATCH, profile=shipped_camera(profile), format_name=profile, rules=SelectionRules(faint_mag))
    previewed, built = preview(request, stars), build(request, stars)
    assert len(previewed.selection.kept) == pytest.approx(len(built.stars), abs=1)
    assert previewed.bytes == pytest.approx(len(built.image), rel=0.02 if len(built.stars) > 50 else 0.2)
    assert previewed.pairs == len(built.distances) == 0


def test_the_screening_list_removes_and_counts_stars(stars):
    """Stars on Moniteq's screening list are removed and counted in the funnel, and the manifest states the reasons."""
    unscreened = build(BAND, stars)
    built = build(replace(BAND, rules=SelectionRules(5.0, screening=ScreeningRules())), stars)
    marks = screen(stars.brighter_than(5.0))
    marked_hip = set(stars.brighter_than(5.0).hip[marks.marked].tolist())
    assert set(built.stars.hip.tolist()) == set(unscreened.stars.hip.tolist()) - marked_hip
    removed = len(unscreened.stars) - len(built.stars)
    assert removed == built.selection.count(Fate.SCREENED) > 0
    assert {f.label: (f.stars, f.dropped) for f in built.selection.funnel}["on the screening list"] == (removed, True)
    screening = built.manifest.assessment["screening"]
    assert screening["counts"]["any"] == removed == len(screening["stars"])
    assert screening["counts"]["variable"] <= removed
    assert built.manifest.counts["on the screening list"] == removed


def test_the_screening_list_can_be_informative_only(stars):
    """With the action "list" every star is kept, and funnel and manifest report the stars on the screening list."""
    built = build(replace(BAND, rules=SelectionRules(5.0, screening=ScreeningRules("list"))), stars)
    assert built.sha256 == build(BAND, stars).sha256
    screening = built.manifest.assessment["screening"]
    last = built.selection.funnel[-1]
    assert (last.label, last.stars) == ("of these on the screening list", sum(s["kept"] for s in screening["stars"]))
    assert last.stars == screening["counts"]["any"] > 0


def test_companions_and_false_triples_can_be_limited(stars):
    """A star is removed if its ring contains more stars than permitted; the numbers equal a brute-force count. An
    equivalent limit on false triples removes the same stars.
    """
    marks = {"doubles": False, "variables": False, "fast": False}
    ring = {"arc_rad": deg(8)[0], "tolerance_rad": deg(0.05)[0]}
    by_count = replace(WHOLE, rules=SelectionRules(5.0, screening=ScreeningRules(most_companions=1, **marks, **ring)))
    prepared = prepare(by_count, stars)
    screened, candidates = prepared.selection.screened, prepared.selection.candidates
    for k in range(0, len(candidates), 97):
        separations = separation_rad(candidates.icrs[k], candidates.icrs)
        assert screened.companions[k] == np.count_nonzero(
            np.abs(separations - ring["arc_rad"]) <= ring["tolerance_rad"]
        )
    assert np.array_equal(prepared.selection.fate == Fate.SCREENED, screened.companions > 1)
    assert 0 < prepared.selection.count(Fate.SCREENED) < len(candidates)
    by_false = ScreeningRules(most_false=1.5 * screened.third, **marks, **ring)
    by_triples = prepare(replace(WHOLE, rules=SelectionRules(5.0, screening=by_false)), stars)
    assert np.array_equal(by_triples.selection.fate, prepared.selection.fate)


def test_any_format_can_have_a_reduced_catalogue(stars):
    """A sunsat image contains all stars, but only the pairs of the reduced catalogue, and its frame. The preview states
    the size.
    """
    complete = replace(WHOLE, bank_bytes=256 * 1024)
    request = replace(complete, reduced=ReducedFrame(*deg(36, 36), 8, deg(3)[0]))
    built, previewed = build(request, stars), preview(request, stars)
    decoded = decode(built.image)
    in_reduced = decoded.tables.reduced.kept
    assert decoded.tables.reduced.frame.brightest == 8
    assert 100 < np.count_nonzero(in_reduced) < len(decoded) == len(build(complete, stars).stars)
    assert in_reduced[decoded.distances.first].all()
    assert in_reduced[decoded.distances.second].all()
    assert built.manifest.counts["reduced catalogue"] == np.count_nonzero(in_reduced)
    assert built.manifest.assessment["reduced"]["width_rad"] == pytest.approx(deg(36)[0])
    assert previewed.pairs == pytest.approx(len(built.distances), rel=0.02)
    assert previewed.bytes - 8 * previewed.pairs == len(built.image) - 8 * len(built.distances)


def test_thinning_by_frames_fills_every_frame(stars):
    """Upright frames of the camera's shape contain at least five of the six requested stars, or all available ones. The
    funnel states the method.
    """
    request = replace(
        WHOLE,
        profile=shipped_camera("cubestar"),
        format_name="cubestar",
        rules=SelectionRules(5.0, brightest_per_field=6),
    )
    circles = prepare(request, stars)
    frames = prepare(replace(request, rules=replace(request.rules, thinning="frames")), stars)
    assert frames.selection.count(Fate.THINNED) > 0
    assert not np.array_equal(frames.selection.fate, circles.selection.fate)
    assert "beyond 6 per upright frame" in [f.label for f in frames.selection.funnel]
    shape, kept_icrs, candidates = frames.plan.shape, frames.selection.kept.icrs, frames.selection.candidates.icrs
    for attitude in survey_attitudes(deg(4)[0])[::50]:
        remaining, available = (np.count_nonzero(shape.inside(unit @ attitude.T)) for unit in (kept_icrs, candidates))
        assert remaining >= min(available, 5)


def test_choices_are_restored_from_their_parameters():
    """A request with all options is restored from its parameters. Older parameters without them are also read."""
    rules = SelectionRules(5.0, thinning="frames", screening=ScreeningRules("list", most_companions=3, most_false=0.1))
    request = replace(WHOLE, rules=rules, reduced=ReducedFrame(*deg(30, 24)))
    parameters = json.loads(json.dumps(parameters_of(request)))
    assert request_from(parameters, WHOLE.profile) == request
    for name in ("thinning", "screening"):
        del parameters["rules"][name]
    del parameters["reduced"]
    assert request_from(parameters, WHOLE.profile) == replace(WHOLE, rules=SelectionRules(5.0))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SelectionRules(5.0, thinning="squares"), "thinning method"),
        (lambda: ScreeningRules("burn"), "unknown screening"),
        (lambda: ScreeningRules(most_companions=-1), "limit of the screening"),
        (lambda: ScreeningRules(most_false=float("nan")), "limit of the screening"),
        (lambda: ScreeningRules(arc_rad=0.0), "ring of the screening"),
        (lambda: replace(WHOLE, reduced=ReducedFrame(0.0, 1.0)), "frame of the reduced"),
        (lambda: replace(WHOLE, reduced=ReducedFrame(0.5, 0.5, 0)), "frame of the reduced"),
    ],
)
def test_invalid_options_are_rejected(make, message):
    """An invalid option is rejected with the expected message."""
    with pytest.raises(BadInput, match=message):
        make()
