"""Each on-board format is uploaded to a unit that reads it, and the unit uses its tables for matching."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.catalogue_tools.onboard import FORMATS, decode, encode, frame_of, read_header, tables_for
from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import Stage
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs
from gss.instruments.golden import GOLDEN_EPOCH_JYEAR
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.pipeline.chains.apriori import PriorState
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.onboard import Commanded, Work, solve
from gss.pipeline.chains.systems import system
from gss.skytables.pairs import distance_table

if TYPE_CHECKING:
    from conftest import Bench

Make = Callable[..., "Bench"]
# Limiting magnitude, largest separation and radius around the bench's pointing. The catalogue fits a bank of 192 KiB.
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
    for camera in sorted(i.name for i in shipped_registry().all() if i.profile.chain)
    for form in shipped_camera(camera).formats
    if (camera, form) != ("sunsat", "cubestar")
]


@lru_cache
def image_for(camera: str, form: str) -> bytes:
    """Return an image with part of the sky for one camera in one format, without tables that need the complete sky."""
    faint_mag, far_deg, reach_deg = SKY[camera]
    stars = propagate(load_stars(faint_mag), GOLDEN_EPOCH_JYEAR)
    stars = stars.take(stars.icrs @ CENTRE > np.cos(np.radians(reach_deg)))
    pairs = distance_table(stars, 0.0044, float(np.radians(far_deg)))
    prepared_tables = tables_for(form, stars, pairs, shipped_camera(camera).camera, index=form == "cubestar")
    return encode(stars, prepared_tables.distances, form, camera, tables=prepared_tables.tables)


def facts(bench: Bench, camera: str, form: str) -> Compatibility:
    return Compatibility(bench.dictionary.device_model, camera, bench.dictionary.hash, FORMATS[form], 2025.0)


def unit_with_bank(make_bench: Make, camera: str, form: str) -> Bench:
    """Return a unit with an uploaded bank."""
    bench = make_bench(camera=camera)
    bench.until(lambda: bench.host.hello is not None)
    image = image_for(camera, form)
    transfer_id = bench.host.transfers.start_upload("catalogue", 1, image, facts(bench, camera, form))
    bench.until(lambda: bench.host.transfer(transfer_id).state in ("committed", "failed", "aborted"), 60.0)
    assert bench.host.transfer(transfer_id).state == "committed", bench.host.transfer(transfer_id).reason
    return bench


def unit_with_active_bank(make_bench: Make, camera: str, form: str) -> Bench:
    """Return a unit that uses an uploaded bank for matching."""
    bench = unit_with_bank(make_bench, camera, form)
    assert bench.do("ACTIVATE_BANK", bank="B", confirm_within_s=600).stage is Stage.COMPLETED
    assert bench.do("CONFIRM_BANK", bank="B").stage is Stage.COMPLETED
    return bench


@pytest.mark.parametrize(("camera", "form"), CASES)
def test_each_format_is_uploaded_and_used_for_matching(make_bench: Make, camera: str, form: str) -> None:
    """An uploaded bank is committed and activated. A lost-in-space solution with it is within 0.05°, and the ground
    reproduces it exactly from the same bytes."""
    bench = unit_with_active_bank(make_bench, camera, form)
    reported = [t.values for t in bench.telemetry("bank_info") if t.values["bank"] == "B"][-1]
    header = read_header(image_for(camera, form))
    assert (reported["format_version"], reported["stars"], reported["pairs"]) == (
        FORMATS[form],
        header.stars,
        header.pairs,
    )
    settings = bench.status()
    done = bench.do("RUN_ITERATION", seconds=70)
    assert (done.stage, done.values["outcome"]) == (Stage.COMPLETED, "solved")
    attitude, truth = bench.telemetry("attitude")[-1].values, bench.telemetry("frame_truth")[-1].values
    rotations = [
        cam_from_icrs(*(np.radians(float(v[n])) for n in ("ra_deg", "dec_deg", "roll_deg"))) for v in (attitude, truth)
    ]
    assert np.linalg.norm(rotations[0] - rotations[1]) < np.radians(0.05)
    repeated = repeat_on_ground(bench, camera, settings)
    assert (repeated == np.array([float(attitude[f"quaternion_{a}"]) for a in "xyzw"])).all()


def test_a_bank_without_required_magnitudes_is_rejected(make_bench: Make) -> None:
    """Sunsat's matching needs magnitudes, so the unit rejects activation of a bank in CubeStar's format with the reason.
    If such a bank is active nevertheless, the attitude report has no solution and states the reason."""
    bench = unit_with_bank(make_bench, "sunsat", "cubestar")
    activation = bench.do("ACTIVATE_BANK", bank="B", confirm_within_s=600)
    assert (activation.stage, activation.reason) == (Stage.FAILED, "incompatible")
    assert "needs magnitudes" in activation.detail
    assert bench.memory.record.active == "golden"
    bench.memory.activate("B")
    done = bench.do("RUN_ITERATION", seconds=70)
    assert (done.stage, done.values["outcome"]) == (Stage.COMPLETED, "none")
    reported = bench.telemetry("attitude")[-1].values
    assert (reported["outcome"], reported["matched"]) == ("none", 0)
    assert "needs magnitudes" in reported["reason"]


def repeat_on_ground(bench: Bench, camera: str, settings: object) -> np.ndarray:
    """Return the quaternion of the first frame from the bytes of bank B."""
    profile, chain, frame, mode = shipped_camera(camera), system(camera), bench.tracker.slots[0], Mode.LOST_IN_SPACE
    least, most = int(settings["min_pixels"]), int(settings["max_pixels"])  # type: ignore[index]
    commanded = Commanded(float(settings["threshold_dn"]) or None, least, most, PriorState().radius_rad(mode))  # type: ignore[index]
    parameters = chain.parameters(profile, frame.exposure_ms / 1000, commanded, mode)
    prepared = chain.prepare(decode(bench.memory.content("B")), profile)
    result = solve(chain, frame.pixels, Work(profile.camera, prepared, parameters, mode, None, frame.dark))
    assert result.attitude is not None
    return result.attitude.quaternion


@pytest.mark.parametrize(("camera", "form"), [("far_mst", "far-mst"), ("oersted", "oersted"), ("aim", "aim")])
def test_a_unit_boots_from_its_own_format_and_uses_its_tables(make_bench: Make, camera: str, form: str) -> None:
    """The factory bank contains the directory, triplets or links, and the chain uses exactly these."""
    bench = make_bench(camera=camera)
    image = bench.memory.content("golden")
    assert read_header(image).format_name == form
    prepared, tables = bench.tracker.chain.prepare(decode(image), shipped_camera(camera)), decode(image).tables
    if camera == "far_mst":
        assert np.array_equal(prepared.directory.sin2, tables.sin2)
        assert np.array_equal(prepared.directory.index.k, tables.index.k)
        assert np.array_equal(prepared.reduced, tables.reduced.kept)
        assert tables.reduced.kept[prepared.directory.first].all()
        assert prepared.reduced.sum() < len(prepared)
    elif camera == "oersted":
        table = tables.constellations.table()
        assert np.array_equal(prepared.triplets.key, table.key)
        assert np.array_equal(prepared.triplets.star, table.star)
        # The unit must not use the factory's triplet table with single-precision limits, because the ground must get
        # the same result.
        assert bench.tracker.tables.prepare(decode(image)).triplets.limit_mag == table.limit_mag
    else:
        assert prepared.links is not None
        assert np.array_equal(prepared.links.neighbour, tables.links.neighbour)


def test_the_chain_uses_the_tables_of_the_bank() -> None:
    """The chain uses a reduced directory, reduced catalogue or coarse triplets of a bank and does not rebuild them."""
    stars = propagate(load_stars(4.0), GOLDEN_EPOCH_JYEAR)
    pairs = distance_table(stars, 0.0044, 0.5)
    profiles = {name: shipped_camera(name) for name in ("far_mst", "oersted", "aim")}
    reduced_frame = frame_of(profiles["far_mst"].camera, float(np.radians(6.0)))
    reduced_tables = tables_for("far-mst", stars, pairs, profiles["far_mst"].camera, reduced=reduced_frame)
    bank = decode(encode(stars, reduced_tables.distances, "far-mst", "far_mst", tables=reduced_tables.tables))
    assert (
        len(system("far_mst").prepare(bank, profiles["far_mst"]).directory)
        == len(reduced_tables.distances)
        < len(pairs)
    )
    # The reduced catalogue applies to a bank of another format too.
    bank = decode(encode(stars, reduced_tables.distances, "sunsat", "far_mst", tables=reduced_tables.tables))
    prepared = system("far_mst").prepare(bank, profiles["far_mst"])
    assert reduced_tables.tables.reduced is not None
    assert np.array_equal(prepared.reduced, reduced_tables.tables.reduced.kept)
    coarse = tables_for("oersted", stars, pairs, profiles["oersted"].camera, uncertainty_rad=0.002)
    bank = decode(encode(stars, coarse.distances, "oersted", "oersted", tables=coarse.tables))
    assert system("oersted").prepare(bank, profiles["oersted"]).triplets.classes.uncertainty_rad == 0.002


@pytest.mark.parametrize("camera", sorted(i.name for i in shipped_registry().all() if i.profile.chain))
def test_a_chain_builds_tables_that_a_bank_lacks(camera: str) -> None:
    """From a bank in another system's format, the chain builds the missing tables with stars and pairs."""
    for form in shipped_camera(camera).formats[1:]:
        if (camera, form) == ("sunsat", "cubestar"):
            continue
        prepared = system(camera).prepare(decode(image_for(camera, form)), shipped_camera(camera))
        assert len(prepared) == read_header(image_for(camera, form)).stars


@pytest.mark.parametrize("camera", ["oersted", "aim"])
def test_a_bank_without_distances_rejects_their_download(make_bench: Make, camera: str) -> None:
    """From a bank without distances, the star list is downloaded and the distance table is rejected."""
    bench = make_bench(camera=camera)
    bench.until(lambda: bench.host.hello is not None)
    image = bench.memory.content("golden")
    header = read_header(image)
    row = 14 if camera == "oersted" else 11
    assert bench.download("star_list", 3) == image[64 : 64 + row * header.stars]
    transfer_id = bench.host.transfers.start_download("distance_table", 3)
    bench.until(lambda: bench.host.transfer(transfer_id).state in ("verified", "failed", "aborted"), 60.0)
    assert "no distance table" in bench.host.transfer(transfer_id).reason


@pytest.mark.parametrize("camera", ["oersted", "aim"])
@pytest.mark.parametrize("chain", ["cubestar", "sunsat", "far_mst"])
def test_a_chain_that_needs_distances_rejects_a_bank_without(camera: str, chain: str) -> None:
    """A chain that needs distances rejects a bank without them, instead of finding no match."""
    bank = decode(image_for(camera, camera))
    with pytest.raises(BadInput, match="needs a distance table"):
        system(chain).prepare(bank, shipped_camera(camera))
