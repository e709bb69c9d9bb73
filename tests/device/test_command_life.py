"""Commands from the queue to completion, over a line with simulated time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.device.protocol import codec
from gss.device.session_events import DeviceEvent, Stage
from gss.domain.errors import BadInput, NotFound
from gss.domain.rotation import matrix_from_quaternion, rotation_angle_rad
from gss.instruments.dictionary.definitions import CommandDefinition, Value, Values
from gss.instruments.dictionary.read_dictionary import load_dictionary

if TYPE_CHECKING:
    from conftest import Bench
ARCSEC = np.pi / 648_000


def quaternion_of(values: object) -> np.ndarray:
    return np.array([values[f"quaternion_{axis}"] for axis in "xyzw"], float)  # type: ignore[index]


def test_device_identifies_itself(bench: Bench) -> None:
    """HELLO is sent automatically when the line opens, and the device replies with its identity."""
    hello = bench.host.hello
    assert hello is not None
    assert (hello.profile, hello.columns, hello.rows, hello.bits) == ("cubestar", 1024, 512, 8)
    assert hello.simulated
    assert hello.dictionary_match
    assert hello.dictionary_hash == load_dictionary().hash_hex


def test_a_command_passes_every_stage_in_order(bench: Bench) -> None:
    """A command passes queued, released, sent, accepted, started, progress and completed, with increasing device time."""
    end = bench.do("RUN_ITERATION")
    stages = [s.stage.value for s in bench.stages(end.request_id)]
    assert stages == ["queued", "released", "sent", "accepted", "started", "progress", "completed"]
    assert end.values == {"frame_number": 1, "outcome": "solved"}
    times = [s.device_time_s for s in bench.stages(end.request_id)[3:]]
    assert times == sorted(times)
    assert times[-1] - times[0] == pytest.approx(0.9 + 0.2, abs=0.15)


def test_an_iteration_reports_every_result_correctly(bench: Bench) -> None:
    """An iteration reports centroids, matches, attitude, timing and truth of one frame. The attitude is within 200″ of
    the rendered one."""
    end = bench.do("RUN_ITERATION")
    for packet in ("frame_info", "centroids", "matches", "attitude", "timing", "frame_truth"):
        (report,) = bench.telemetry(packet)
        assert report.values["frame_number"] == 1
        assert report.request_id == end.request_id
    attitude, truth = bench.telemetry("attitude")[0], bench.telemetry("frame_truth")[0]
    assert truth.simulator_only
    error_rad = rotation_angle_rad(
        matrix_from_quaternion(quaternion_of(attitude.values)), matrix_from_quaternion(quaternion_of(truth.values))
    )
    assert error_rad < 200 * ARCSEC
    assert len(bench.telemetry("centroids")[0].lists["items"]) == attitude.values["centroids"]
    assert len(bench.telemetry("matches")[0].lists["items"]) == attitude.values["matched"]


def test_single_steps_equal_one_iteration(bench: Bench) -> None:
    """TAKE_IMAGE, FIND_CENTROIDS, MATCH_STARS and CALCULATE_ATTITUDE, sent one after another, solve a frame."""
    taken = bench.do("TAKE_IMAGE", slot=1, exposure_ms=200)
    assert taken.values == {"frame_number": 1, "slot": 1}
    found = bench.do("FIND_CENTROIDS", slot=1)
    matched = bench.do("MATCH_STARS")
    solved = bench.do("CALCULATE_ATTITUDE")
    assert 10 <= int(found.values["centroids"]) <= 20
    assert int(matched.values["matched"]) >= 4
    assert solved.values == {"frame_number": 1, "outcome": "solved"}
    info = bench.telemetry("frame_info")[0].values
    assert (info["slot"], info["exposure_ms"], info["source"]) == (1, 200, "captured")


def test_matches_name_rows_of_the_active_catalogue(bench: Bench, golden_catalogue: object) -> None:
    """Star numbers in telemetry are rows of the bank. With its manifest they identify the rendered stars."""
    bench.do("RUN_ITERATION")
    truth = bench.tracker.slots[0].truth
    assert truth is not None
    place = dict(zip(truth.hip.tolist(), truth.pixels.tolist(), strict=True))
    centroids = bench.telemetry("centroids")[0].lists["items"]
    for match in bench.telemetry("matches")[0].lists["items"]:
        col, row = place[int(golden_catalogue.hip[int(match["star"])])]  # type: ignore[attr-defined]
        spot = centroids[int(match["centroid"])]
        assert np.hypot(float(spot["col_px"]) - col, float(spot["row_px"]) - row) < 2.0


def test_housekeeping_is_sent_once_a_second(bench: Bench) -> None:
    """Housekeeping is sent automatically at 1 Hz, with power values within limits on a healthy unit."""
    bench.events.clear()
    bench.run(10.0)
    reports = bench.telemetry("housekeeping")
    assert len(reports) == 10
    assert all(r.request_id == 0 for r in reports)
    assert np.diff([r.device_time_s for r in reports]) == pytest.approx(np.ones(9), abs=0.02)
    for field in bench.dictionary.packet("housekeeping").values:
        if field.page == "power":
            assert field.limits.state(float(reports[0].values[field.name])).value == "ok", field.name


def test_the_cycle_gives_an_attitude_every_second(bench: Bench) -> None:
    """The cycle takes one image while it solves the previous one, so results are up to 1.5 s old."""
    bench.do("START_CYCLE")
    bench.events.clear()
    bench.run(6.0)
    reports = bench.telemetry("attitude")
    assert 5 <= len(reports) <= 6
    assert [r.values["outcome"] for r in reports] == ["solved"] * len(reports)
    ages = [r.device_time_s - float(r.values["frame_time_s"]) for r in reports]
    assert all(0.5 < age < 1.5 for age in ages)
    assert bench.do("TAKE_IMAGE").reason == "wrong_state"
    assert bench.do("STOP_CYCLE").stage is Stage.COMPLETED
    bench.events.clear()
    bench.run(3.0)
    assert not bench.telemetry("attitude")


def test_mode_follows_the_result(bench: Bench) -> None:
    """After a solution the mode is tracking, which housekeeping and an event report."""
    bench.do("RUN_ITERATION")
    assert bench.do("GET_STATUS").stage is Stage.COMPLETED
    assert bench.host.housekeeping is not None
    assert bench.host.housekeeping["mode"] == "tracking"
    assert any(isinstance(e, DeviceEvent) and e.name == "MODE_CHANGED" for e in bench.events)
    bench.do("RUN_ITERATION")
    assert bench.telemetry("attitude")[-1].values["mode"] == "tracking"


def test_a_command_in_the_wrong_mode_is_rejected(bench: Bench) -> None:
    """The device checks preconditions. Its report has the reason and the condition."""
    bench.do("SET_MODE", mode="standby")
    end = bench.do("START_CYCLE")
    assert (end.stage, end.reason) == (Stage.REJECTED, "wrong_state")
    assert "Mode is not standby" in end.detail
    assert bench.do("SET_MODE", mode="tracking").reason == "wrong_state"
    bench.do("SET_ATTITUDE_HINT", ra_deg=84.0, dec_deg=5.0, roll_deg=17.2, uncertainty_deg=5.0)
    assert bench.do("SET_MODE", mode="assisted").stage is Stage.COMPLETED
    bench.do("RUN_ITERATION")
    assert bench.telemetry("attitude")[-1].values["mode"] == "assisted"
    assert bench.telemetry("attitude")[-1].values["outcome"] == "solved"


def test_steps_without_their_input_fail_with_the_reason(bench: Bench) -> None:
    """A step fails with the reason if its image, centroids or matches are missing."""
    assert bench.do("FIND_CENTROIDS", slot=3).reason == "no_image"
    assert "FIND_CENTROIDS" in bench.do("MATCH_STARS").detail
    assert "MATCH_STARS" in bench.do("CALCULATE_ATTITUDE").detail


def test_detection_settings_are_used_by_the_chain(bench: Bench) -> None:
    """With a higher threshold fewer stars are detected. Contradictory sizes are rejected on board."""
    bench.do("TAKE_IMAGE")
    many = int(bench.do("FIND_CENTROIDS").values["centroids"])
    bench.do("SET_DETECTION", threshold_dn=100)
    few = int(bench.do("FIND_CENTROIDS").values["centroids"])
    assert few < many
    assert bench.do("SET_DETECTION", min_pixels=30, max_pixels=20).reason == "out_of_range"


def test_invalid_arguments_are_rejected_on_the_ground(bench: Bench) -> None:
    """Range, type and name are checked before a command is queued, and no id is used."""
    before = bench.host.next_request_id
    for name, arguments in (
        ("SET_EXPOSURE", {"exposure_ms": 2001}),
        ("SET_MODE", {"mode": "sleep"}),
        ("HELLO", {"x": 1}),
    ):
        with pytest.raises(BadInput):
            bench.host.submit(bench.host.encode(name, arguments))
    with pytest.raises(NotFound):
        bench.host.submit(bench.host.encode("SELF_DESTRUCT", {}))
    assert bench.host.next_request_id == before


def test_the_device_checks_ranges_too(bench: Bench) -> None:
    """If the ground's checks are bypassed, the device rejects a value out of range and payloads of the wrong length."""
    queue = bench.host._command_queue
    for request_id, payload, reason in (
        (900, b"\xff\xff", "out_of_range"),
        (901, b"\1", "bad_length"),
        (902, bytes(3), "bad_length"),
    ):
        queue.add(request_id, bench.host.encode("SET_EXPOSURE", {"exposure_ms": 5}))
        record = queue.record(request_id)
        assert record is not None
        record.payload = payload
        bench.until(lambda i=request_id: bench.stage(i) is Stage.REJECTED)
        assert bench.stages(request_id)[-1].reason == reason


def test_preview_shows_the_bytes_that_are_sent(bench: Bench) -> None:
    """The preview has the bytes of the packet that the next submit sends, in labelled groups."""
    groups = bench.host.preview(bench.host.encode("TAKE_IMAGE", {"slot": 2, "exposure_ms": 300}))
    assert [label for label, _ in groups][8:] == ["slot", "exposure_ms", "CRC-32"]
    assert dict(groups)["slot"] == b"\x02"
    assert dict(groups)["exposure_ms"] == b"\x01\x2c"
    bench.host.submit(bench.host.encode("TAKE_IMAGE", {"slot": 2, "exposure_ms": 300}))
    out, _ = bench.host.poll(bench.now_s)
    from cobs import cobs

    assert cobs.decode(out.strip(b"\0")) == b"".join(data for _, data in groups)


def test_arguments_are_validated_once_from_the_request_to_the_wire(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Preview and transmission use the result of a single validation."""
    calls: list[str] = []
    check = codec.check_arguments

    def counting(command: CommandDefinition, arguments: Values) -> dict[str, Value]:
        calls.append(command.name)
        return check(command, arguments)

    monkeypatch.setattr(codec, "check_arguments", counting)
    order = bench.host.encode("TAKE_IMAGE", {"slot": 2, "exposure_ms": 300})
    bench.host.preview(order)
    request_id = bench.host.submit(order)
    bench.until(lambda: bench.stage(request_id) is Stage.COMPLETED)
    assert calls == ["TAKE_IMAGE"]
