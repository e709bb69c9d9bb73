"""Each on-board format goes up to a unit that reads it, and the unit matches from it, with the tables that came in it."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.catalogue_tools.onboard import FORMATS, decode, encode, frame_of, read_header, tables_for
from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.catalogue_tools.tables.distances import distance_table
from gss.device.golden import GOLDEN_EPOCH_JYEAR, bank_formats
from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import Stage
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs
from gss.domain.profiles import PROFILES, profile
from gss.pipeline.chains.apriori import Known
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.onboard import Commanded, Work, solve
from gss.pipeline.chains.systems import on_board

if TYPE_CHECKING:
    from conftest import Bench

Make = Callable[..., "Bench"]
# How deep, how far apart, and how far around where the bench looks, so that each bank holds it: 192 KiB.
SKY = {
    "cubestar": (3.8, 40.0, 60.0),
    "sunsat": (6.0, 12.0, 25.0),
    "far_mst": (4.25, 30.0, 60.0),
    "oersted": (4.5, 24.0, 60.0),
    "aim": (6.0, 4.8, 60.0),
}
CENTRE = cam_from_icrs(np.radians(84.0), np.radians(5.0), 0.3)[2]
CASES = [
    (camera, form)
    for camera in sorted(PROFILES)
    for form in bank_formats(camera)
    if (camera, form) != ("sunsat", "cubestar")
]


@lru_cache
def image_for(camera: str, form: str) -> bytes:
    """A part of the sky for one camera in one format, without the tables that need a whole one."""
    faint_mag, far_deg, reach_deg = SKY[camera]
    stars = propagate(load_stars(faint_mag), GOLDEN_EPOCH_JYEAR)
    stars = stars.take(stars.icrs @ CENTRE > np.cos(np.radians(reach_deg)))
    pairs = distance_table(stars, 0.0044, float(np.radians(far_deg)))
    own = tables_for(form, stars, pairs, profile(camera).camera, index=form == "cubestar")
    return encode(stars, own.distances, form, camera, tables=own.tables)


def facts(bench: Bench, camera: str, form: str) -> Compatibility:
    return Compatibility(bench.dictionary.device_model, camera, bench.dictionary.hash, FORMATS[form], 2025.0)


def loaded(make_bench: Make, camera: str, form: str) -> Bench:
    """A unit with an uploaded bank."""
    bench = make_bench(camera=camera)
    bench.until(lambda: bench.host.hello is not None)
    image = image_for(camera, form)
    transfer_id = bench.host.start_upload("catalogue", 1, image, facts(bench, camera, form), bench.now_s)
    bench.until(lambda: bench.host.transfer(transfer_id).state in ("committed", "failed", "aborted"), 60.0)
    assert bench.host.transfer(transfer_id).state == "committed", bench.host.transfer(transfer_id).reason
    return bench


def active(make_bench: Make, camera: str, form: str) -> Bench:
    """A unit that matches from an uploaded bank."""
    bench = loaded(make_bench, camera, form)
    assert bench.do("ACTIVATE_BANK", bank="B", confirm_within_s=600).stage is Stage.COMPLETED
    assert bench.do("CONFIRM_BANK", bank="B").stage is Stage.COMPLETED
    return bench


@pytest.mark.parametrize(("camera", "form"), CASES)
def test_each_format_goes_up_and_the_unit_matches_from_it(make_bench: Make, camera: str, form: str) -> None:
    """Committed, activated, lost in space solved from it within 0.05°, and the ground repeats that from the same bytes bit
    for bit."""
    bench = active(make_bench, camera, form)
    told = [t.values for t in bench.telemetry("bank_info") if t.values["bank"] == "B"][-1]
    header = read_header(image_for(camera, form))
    assert (told["format_version"], told["stars"], told["pairs"]) == (FORMATS[form], header.stars, header.pairs)
    settings = bench.status()
    done = bench.do("RUN_ITERATION", seconds=70)
    assert (done.stage, done.values["outcome"]) == (Stage.COMPLETED, "solved")
    found, truth = bench.telemetry("attitude")[-1].values, bench.telemetry("frame_truth")[-1].values
    rotations = [
        cam_from_icrs(*(np.radians(float(v[n])) for n in ("ra_deg", "dec_deg", "roll_deg"))) for v in (found, truth)
    ]
    assert np.linalg.norm(rotations[0] - rotations[1]) < np.radians(0.05)
    repeated = repeat_on_ground(bench, camera, settings)
    assert (repeated == np.array([float(found[f"quaternion_{a}"]) for a in "xyzw"])).all()


def test_a_bank_without_magnitudes_is_refused_where_they_are_needed(make_bench: Make) -> None:
    """Sunsat's matching goes by magnitudes: its unit does not activate a bank in CubeStar's format, and says why; where such
    a bank is active all the same, each attitude that is not found gives the reason."""
    bench = loaded(make_bench, "sunsat", "cubestar")
    refused = bench.do("ACTIVATE_BANK", bank="B", confirm_within_s=600)
    assert (refused.stage, refused.reason) == (Stage.FAILED, "incompatible")
    assert "needs magnitudes" in refused.detail
    assert bench.memory.record.active == "golden"
    bench.memory.activate("B")
    done = bench.do("RUN_ITERATION", seconds=70)
    assert (done.stage, done.values["outcome"]) == (Stage.COMPLETED, "none")
    told = bench.telemetry("attitude")[-1].values
    assert (told["outcome"], told["matched"]) == ("none", 0)
    assert "needs magnitudes" in told["reason"]


def repeat_on_ground(bench: Bench, camera: str, settings: object) -> np.ndarray:
    """The quaternion of the first frame from the bytes of bank B."""
    own, chain, frame, mode = profile(camera), on_board(camera), bench.tracker.slots[0], Mode.LOST_IN_SPACE
    least, most = int(settings["min_pixels"]), int(settings["max_pixels"])  # type: ignore[index]
    commanded = Commanded(float(settings["threshold_dn"]) or None, least, most, Known().radius_rad(mode))  # type: ignore[index]
    parameters = chain.parameters(own, frame.exposure_ms / 1000, commanded, mode)
    prepared = chain.prepare(decode(bench.memory.content("B")), own)
    result = solve(chain, frame.pixels, Work(own.camera, prepared, parameters, mode, None))
    assert result.attitude is not None
    return result.attitude.quaternion


@pytest.mark.parametrize(("camera", "form"), [("far_mst", "far-mst"), ("oersted", "oersted"), ("aim", "aim")])
def test_a_unit_boots_from_its_own_format_and_uses_its_tables(make_bench: Make, camera: str, form: str) -> None:
    """The factory bank holds directory, triplets or links, and what the chain works with is what the bank says."""
    bench = make_bench(camera=camera)
    image = bench.memory.content("golden")
    assert read_header(image).format_name == form
    prepared, tables = bench.tracker.chain.prepare(decode(image), profile(camera)), decode(image).tables
    if camera == "far_mst":
        assert np.array_equal(prepared.directory.sin2, tables.sin2)
        assert np.array_equal(prepared.directory.k, tables.index.k)
        assert np.array_equal(prepared.reduced, tables.reduced.kept)
        assert tables.reduced.kept[prepared.directory.first].all()
        assert prepared.reduced.sum() < len(prepared)
    elif camera == "oersted":
        table = tables.constellations.table()
        assert np.array_equal(prepared.triplets.key, table.key)
        assert np.array_equal(prepared.triplets.star, table.star)
        # Not the factory's triplet table, whose limits are single precision: the ground must find the same.
        assert bench.tracker.tables.prepare(decode(image)).triplets.limit_mag == table.limit_mag
    else:
        assert prepared.links is not None
        assert np.array_equal(prepared.links.neighbour, tables.links.neighbour)


def test_the_tables_of_the_bank_decide_and_not_the_stars() -> None:
    """A bank whose directory, triplets or links were thinned out gives a chain just those: nothing is rebuilt behind it."""
    stars = propagate(load_stars(4.0), GOLDEN_EPOCH_JYEAR)
    pairs = distance_table(stars, 0.0044, 0.5)
    own = {name: profile(name) for name in ("far_mst", "oersted", "aim")}
    few = frame_of(own["far_mst"].camera, float(np.radians(6.0)))
    made = tables_for("far-mst", stars, pairs, own["far_mst"].camera, reduced=few)
    bank = decode(encode(stars, made.distances, "far-mst", "far_mst", tables=made.tables))
    assert len(on_board("far_mst").prepare(bank, own["far_mst"]).directory) == len(made.distances) < len(pairs)
    # The reduced catalogue counts in a bank of another format too.
    bank = decode(encode(stars, made.distances, "sunsat", "far_mst", tables=made.tables))
    prepared = on_board("far_mst").prepare(bank, own["far_mst"])
    assert made.tables.reduced is not None
    assert np.array_equal(prepared.reduced, made.tables.reduced.kept)
    coarse = tables_for("oersted", stars, pairs, own["oersted"].camera, uncertainty_rad=0.002)
    bank = decode(encode(stars, coarse.distances, "oersted", "oersted", tables=coarse.tables))
    assert on_board("oersted").prepare(bank, own["oersted"]).triplets.classes.uncertainty_rad == 0.002


@pytest.mark.parametrize("camera", sorted(PROFILES))
def test_a_unit_without_its_own_tables_makes_them(camera: str) -> None:
    """A bank in another system's format still prepares: the chain makes what it needs from stars and pairs."""
    for form in bank_formats(camera)[1:]:
        if (camera, form) == ("sunsat", "cubestar"):
            continue
        prepared = on_board(camera).prepare(decode(image_for(camera, form)), profile(camera))
        assert len(prepared) == read_header(image_for(camera, form)).stars


@pytest.mark.parametrize("camera", ["oersted", "aim"])
def test_a_bank_without_distances_says_so(make_bench: Make, camera: str) -> None:
    """The distance table of a format that has none is not downloaded but refused; the star list comes."""
    bench = make_bench(camera=camera)
    bench.until(lambda: bench.host.hello is not None)
    image = bench.memory.content("golden")
    header = read_header(image)
    row = 14 if camera == "oersted" else 11
    assert bench.bring("star_list", 3) == image[64 : 64 + row * header.stars]
    transfer_id = bench.host.start_download("distance_table", 3, bench.now_s)
    bench.until(lambda: bench.host.transfer(transfer_id).state in ("verified", "failed", "aborted"), 60.0)
    assert "no distance table" in bench.host.transfer(transfer_id).reason


@pytest.mark.parametrize("camera", ["oersted", "aim"])
@pytest.mark.parametrize("chain", ["cubestar", "sunsat", "far_mst"])
def test_a_chain_that_needs_distances_refuses_a_bank_without(camera: str, chain: str) -> None:
    """Another system's chain over triplets or links says what it misses, instead of finding nothing for ever."""
    bank = decode(image_for(camera, camera))
    with pytest.raises(BadInput, match="matches by a distance table"):
        on_board(chain).prepare(bank, profile(camera))
