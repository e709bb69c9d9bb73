"""Calibration, parameter and triplet tables on board: upload, verification, trial activation, confirmation, rollback, and
their effects.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.catalogue_tools.formats.triplet_table import HEADER_VERSION, encode_triplets
from gss.catalogue_tools.onboard import decode, read_header
from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import Stage, TransferUpdate
from gss.device.table_use import calibration_values, parameter_values
from gss.device.tables import (
    BAD_PIXEL_BYTES,
    TABLE_FORMAT,
    Scalar,
    decode_bad_pixels,
    encode_bad_pixels,
    encode_table,
)
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.oersted_match import prepare

if TYPE_CHECKING:
    from conftest import Bench

BANK = {"A": 0, "B": 1, "factory": 3}
CUBESTAR = shipped_camera("cubestar")


def send(bench: Bench, kind: str, bank: str, data: bytes, version: int = TABLE_FORMAT) -> TransferUpdate:
    """Upload a table and return its final update."""
    name = bench.tracker.profile.name
    facts = Compatibility(bench.dictionary.device_model, name, bench.dictionary.hash, version)
    transfer_id = bench.host.transfers.start_upload(kind, BANK[bank], data, facts)
    bench.until(lambda: bench.host.transfer(transfer_id).state in ("committed", "failed", "aborted"), 60.0)
    return bench.host.transfer(transfer_id)


def calibration(**change: Scalar) -> bytes:
    return encode_table("calibration", "cubestar", calibration_values(CUBESTAR) | change)


def parameters(**change: Scalar) -> bytes:
    return encode_table("parameters", "cubestar", parameter_values(CUBESTAR) | change)


def table_info(bench: Bench, table: str, bank: str) -> dict[str, object]:
    packets = [
        t.values for t in bench.telemetry("table_info") if (t.values["table"], t.values["bank"]) == (table, bank)
    ]
    return dict(packets[-1])


def test_tables_are_listed_with_their_content(bench: Bench) -> None:
    """The device lists four tables in three banks. The factory's calibration, parameters and empty bad-pixel table are
    active, and CubeStar has no triplets."""
    assert bench.do("LIST_TABLES").values == {"count": 12}
    assert table_info(bench, "bad_pixels", "A")["capacity_bytes"] == BAD_PIXEL_BYTES
    assert decode_bad_pixels(bench.download("bad_pixels", 3))[1].shape == (0, 2)
    for table in ("calibration", "parameters"):
        info = table_info(bench, table, "factory")
        assert (info["state"], info["active"], info["profile"]) == ("committed", True, "cubestar")
        assert info["sha256"] == bytes.fromhex(bench.memory.hash_of(f"{table}.factory"))
    assert table_info(bench, "triplets", "factory")["state"] == "empty"
    assert table_info(bench, "calibration", "A")["capacity_bytes"] == 4096
    assert bench.download("calibration", 3) == calibration()


def test_another_calibration_changes_the_matches(bench: Bench) -> None:
    """With a focal length that is wrong by 10 % the image is not solved. After a rollback it is solved."""
    bench.do("TAKE_IMAGE")
    wrong = calibration(
        focal_col_px=1.1 * CUBESTAR.camera.focal_col_px, focal_row_px=1.1 * CUBESTAR.camera.focal_row_px
    )
    assert send(bench, "calibration", "A", wrong).state == "committed"

    def outcome() -> object:
        bench.do("FIND_CENTROIDS")
        bench.do("MATCH_STARS")
        bench.do("CALCULATE_ATTITUDE")
        return bench.telemetry("attitude")[-1].values["outcome"]

    assert outcome() == "solved"
    bench.do("SET_MODE", mode="lost_in_space")
    assert bench.do("ACTIVATE_TABLE", table="calibration", bank="A").stage is Stage.COMPLETED
    assert bench.status()["calibration_bank"] == "A"
    assert outcome() == "none"
    bench.do("SET_MODE", mode="lost_in_space")
    assert bench.do("ROLLBACK_TABLE", table="calibration").stage is Stage.COMPLETED
    assert bench.status()["calibration_bank"] == "factory"
    assert outcome() == "solved"


def test_other_parameters_replace_the_chains_constants(bench: Bench) -> None:
    """A table with at most five centroids limits them to five. Its threshold becomes the setting, and a command overrides
    it."""
    bench.do("TAKE_IMAGE")
    bench.do("FIND_CENTROIDS")
    many = len(bench.telemetry("centroids")[-1].lists["items"])
    send(bench, "parameters", "B", parameters(max_centroids=5, threshold_dn=20.0))
    bench.do("ACTIVATE_TABLE", table="parameters", bank="B")
    assert bench.status()["threshold_dn"] == 20
    bench.do("FIND_CENTROIDS")
    assert len(bench.telemetry("centroids")[-1].lists["items"]) == 5 < many
    bench.do("SET_DETECTION", threshold_dn=200)
    bench.do("FIND_CENTROIDS")
    assert len(bench.telemetry("centroids")[-1].lists["items"]) < 5


def test_bad_pixels_are_replaced_before_the_detection(bench: Bench) -> None:
    """Groups of hot pixels are false detections. With their table active the detections are those of a detector without
    hot pixels, and the downloaded image still contains the hot pixels."""

    def stars() -> list[tuple[float, float]]:
        bench.do("TAKE_IMAGE")
        bench.do("FIND_CENTROIDS")
        items = bench.telemetry("centroids")[-1].lists["items"]
        return [(float(i["col_px"]), float(i["row_px"])) for i in items]

    clean = stars()
    bench.do("SIM_INJECT", fault="hot_pixels", value=8)
    hot = np.array([(h.col, h.row) for h in bench.tracker.sky.environment.hot_pixels])
    assert len(hot) == 8 * 9

    def false(found: list[tuple[float, float]]) -> int:
        return sum(bool((np.abs(hot - np.array(c)).max(axis=1) < 2).any()) for c in found)

    assert false(clean) == 0
    assert false(stars()) >= 6, "a group at the edge or beside a star is not a separate detection"
    table = encode_bad_pixels("cubestar", hot)
    assert send(bench, "bad_pixels", "A", table).state == "committed"
    bench.do("SET_MODE", mode="lost_in_space")
    assert bench.do("ACTIVATE_TABLE", table="bad_pixels", bank="A").stage is Stage.COMPLETED
    assert bench.status()["bad_pixels_bank"] == "A"
    masked = stars()
    assert (false(masked), len(masked)) == (0, len(clean))
    frame = bench.tracker.imager.stored(0)
    assert np.median(frame.pixels[hot[:, 1], hot[:, 0]]) > 60

    bench.do("SET_MODE", mode="lost_in_space")
    bench.do("ROLLBACK_TABLE", table="bad_pixels")
    assert false(stars()) >= 6
    bench.do("SIM_INJECT", fault="none")
    assert false(stars()) == 0


def test_parameters_select_the_chain(make_bench: Callable[..., Bench]) -> None:
    """A parameter table makes an AIM unit run CubeStar's chain."""
    bench = make_bench(camera="aim")
    bench.until(lambda: bench.host.hello is not None)
    from gss.pipeline.chains.systems import system

    values = parameter_values(shipped_camera("aim"), system("cubestar"))
    assert send(bench, "parameters", "A", encode_table("parameters", "aim", values)).state == "committed"
    bench.do("ACTIVATE_TABLE", table="parameters", bank="A")
    assert bench.tracker.chain.name == "cubestar"


def test_an_unconfirmed_table_falls_back(bench: Bench) -> None:
    """An unconfirmed table falls back after the trial time and after a reset. A confirmed table remains active."""
    send(bench, "calibration", "A", calibration(bias_dn=9.0))
    bench.do("ACTIVATE_TABLE", table="calibration", bank="A", confirm_within_s=10)
    assert table_info(bench, "calibration", "A")["confirm_left_s"] == 10
    assert bench.do("ACTIVATE_TABLE", table="calibration", bank="factory").reason == "wrong_state"
    bench.run(10.5)
    assert bench.status()["calibration_bank"] == "factory"
    bench.do("ACTIVATE_TABLE", table="calibration", bank="A")
    bench.do("RESET")
    bench.run(1.0)
    assert bench.status()["calibration_bank"] == "factory"
    assert len(bench.device_events("TABLE_FELL_BACK")) == 2
    bench.do("ACTIVATE_TABLE", table="calibration", bank="A")
    assert bench.do("CONFIRM_TABLE", table="calibration").stage is Stage.COMPLETED
    bench.do("RESET")
    bench.run(1.0)
    assert bench.status()["calibration_bank"] == "A"
    assert bench.tracker.tables.profile.sensor.bias_dn == 9.0


def test_a_table_is_not_uploaded_while_it_is_erased(bench: Bench) -> None:
    """An upload that is opened while the same table is erased is rejected as ``busy``. The ground opens it again after the end
    of the command, and it is committed. ABORT ends the command, so that the table can be uploaded at once."""
    request_id = bench.host.submit(bench.host.encode("ERASE_TABLE", {"table": "calibration", "bank": "A"}))
    bench.until(lambda: bench.stage(request_id) is Stage.STARTED)
    digest = bytes(32)
    offer = {"kind": "calibration", "target": 0, "size_bytes": 100, "chunk_bytes": 64, "sha256": digest}
    facts = {"device_model": bench.dictionary.device_model, "profile": "cubestar", "format_version": TABLE_FORMAT}
    unused = {"dictionary_hash": bench.dictionary.hash, "stars": 0, "pairs": 0, "epoch_jyear": 0.0}
    assert bench.refusal("OPEN_UPLOAD", offer | facts | unused) == "busy"
    assert send(bench, "calibration", "A", calibration()).state == "committed"
    bench.run(1.0)
    assert bench.stage(request_id) is Stage.COMPLETED
    assert bench.memory.content("calibration.A") == calibration()
    request_id = bench.host.submit(bench.host.encode("VERIFY_TABLE", {"table": "calibration", "bank": "A"}))
    bench.until(lambda: bench.stage(request_id) is Stage.STARTED)
    bench.do("ABORT")
    assert (
        send(bench, "calibration", "A", calibration(focal_col_px=1.1 * CUBESTAR.camera.focal_col_px)).state
        == "committed"
    )


def test_a_corrupt_table_is_detected_and_not_used(bench: Bench) -> None:
    """After a bit flip, VERIFY_TABLE fails. If the table is active, the unit reports it at boot and uses its default
    values."""
    send(bench, "calibration", "A", calibration(bias_dn=9.0))
    bench.do("ACTIVATE_TABLE", table="calibration", bank="A")
    bench.do("CONFIRM_TABLE", table="calibration")
    bench.memory.flash.flip(bench.memory.offset("calibration.A") + 100, 3)
    verified = bench.do("VERIFY_TABLE", table="calibration", bank="A")
    assert (verified.stage, verified.reason) == (Stage.FAILED, "bank_corrupt")
    bench.do("RESET")
    bench.run(1.0)
    assert bench.device_events("TABLE_CORRUPT")[-1].text.startswith("calibration A")
    assert bench.tracker.tables.profile == CUBESTAR
    assert bench.do("VERIFY_TABLE", table="calibration", bank="B").reason == "bank_empty"


def test_active_and_factory_tables_cannot_be_written_or_erased(bench: Bench) -> None:
    """Uploads and ERASE_TABLE are rejected for factory tables as ``write_protected`` and for active ones as
    ``bank_active``."""
    assert "write_protected" in send(bench, "parameters", "factory", parameters()).reason
    assert bench.do("ERASE_TABLE", table="parameters", bank="factory").reason == "write_protected"
    send(bench, "parameters", "A", parameters(max_centroids=9))
    bench.do("ACTIVATE_TABLE", table="parameters", bank="A")
    assert "bank_active" in send(bench, "parameters", "A", parameters(max_centroids=8)).reason
    assert bench.do("ERASE_TABLE", table="parameters", bank="A").reason == "bank_active"
    bench.do("ROLLBACK_TABLE", table="parameters")
    assert bench.do("ERASE_TABLE", table="parameters", bank="A").stage is Stage.COMPLETED
    assert table_info(bench, "parameters", "A")["state"] == "empty"
    assert bench.do("ROLLBACK_TABLE", table="triplets").reason == "wrong_state"


@pytest.mark.parametrize(
    ("kind", "data", "says"),
    [
        (
            "calibration",
            encode_table("calibration", "sunsat", calibration_values(shipped_camera("sunsat"))),
            "is for sunsat",
        ),
        ("calibration", calibration(columns=1000), "another detector"),
        ("calibration", calibration(focal_col_px=-1.0), "greater than zero"),
        ("calibration", calibration(distortion="fisheye"), "unknown distortion model"),
        ("calibration", calibration(k9=1.0), "missing or unknown values"),
        ("parameters", parameters(chain="unknown"), "unknown chain"),
        ("parameters", parameters(max_centroids=5.5), "wrong type"),
        ("parameters", parameters(spice=1.0), "no such constant"),
        ("parameters", calibration(), "not a parameters table"),
        ("triplets", b"GSST" + bytes(100), ""),
    ],
)
def test_implausible_tables_are_rejected_at_the_commit(bench: Bench, kind: str, data: bytes, says: str) -> None:
    """A table of another camera or detector, with invalid values, or damaged is rejected as incompatible, and the bank
    remains empty."""
    update = send(bench, kind, "A", data, HEADER_VERSION if kind == "triplets" else TABLE_FORMAT)
    assert update.state in ("failed", "aborted")
    assert "incompatible" in update.reason
    assert says in update.reason
    assert bench.do("ACTIVATE_TABLE", table=kind, bank="A").reason == "bank_empty"


def test_triplets_replace_those_that_the_unit_builds_itself(make_bench: Callable[..., Bench]) -> None:
    """With an uploaded table of 50 triplets, Oersted matches no stars. After a rollback to the factory table it does."""
    bench = make_bench(camera="oersted")
    bench.until(lambda: bench.host.hello is not None)
    profile, image = shipped_camera("oersted"), bench.memory.content("golden")
    full = prepare(decode(image), profile).triplets
    assert bench.memory.record.tables["triplets"].active == "factory"
    bench.do("TAKE_IMAGE")
    reduced = replace(full, key=full.key[:50], star=full.star[:50])
    crc = read_header(image).body_crc32
    assert send(bench, "triplets", "A", encode_triplets(reduced, crc), HEADER_VERSION).state == "committed"
    assert bench.do("ACTIVATE_TABLE", table="triplets", bank="A").stage is Stage.COMPLETED
    bench.do("FIND_CENTROIDS")
    assert bench.do("MATCH_STARS").stage is Stage.FAILED
    bench.do("ROLLBACK_TABLE", table="triplets")
    bench.do("FIND_CENTROIDS")
    assert bench.do("MATCH_STARS").stage is Stage.COMPLETED
