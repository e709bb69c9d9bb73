"""OreSat's star tracker: driver, package and simulated unit compared with public vectors, and invalid input."""

from __future__ import annotations

import dataclasses
import hashlib
import io

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from gss.device.can_frames import CanFrame
from gss.device.driver import Driver, UnitSetup, open_driver
from gss.device.oresat_driver import SILENT_S, open_session
from gss.device.oresat_objects import LAST_CAPTURE, PREVIEW
from gss.device.oresat_state import STEADY_S, SensorImages
from gss.device.sdo_client import SdoClient
from gss.device.sdo_downloads import SdoDownloads
from gss.device.session_events import (
    CommandUpdate,
    DeviceEvent,
    SessionEvent,
    Stage,
    Telemetry,
    TransferDone,
    TransferState,
    TransferUpdate,
)
from gss.device.simulator.environment import Environment
from gss.device.simulator.orbit import Inertial
from gss.device.simulator.oresat import BLOCK, BOOT_S, BOOTING, MIDNIGHT, OLDER, OresatUnit, open_unit
from gss.device.simulator.other_makers import UnitWorld
from gss.domain.errors import BadInput, Conflict
from gss.domain.frames import cam_from_icrs, ra_dec_roll_rad
from gss.domain.rotation import matrix_from_quaternion
from gss.instruments.dictionary.definitions import Value
from gss.instruments.package import Instrument
from gss.instruments.registry import shipped_registry

ATTITUDE = cam_from_icrs(*np.radians([84.0, 5.0, 30.0]))
REQUEST, ANSWER = 0x62C, 0x5AC


@pytest.fixture(scope="module")
def oresat() -> Instrument:
    """The shipped package."""
    return shipped_registry().get("oresat")


def unit_of(instrument: Instrument, *dialects: str, rate_rad_s: float = 0.0) -> OresatUnit:
    """Return a simulated unit that points to ``ATTITUDE`` and rotates with this rate."""
    environment = Environment(instrument.profile, Inertial(ATTITUDE, np.array([0.0, rate_rad_s, 0.0])))
    return open_unit(UnitWorld(instrument, environment, 1, frozenset(dialects)))


def frame(identifier: int, text: str) -> bytes:
    """Return the record of a CAN frame."""
    return CanFrame(identifier, bytes.fromhex(text)).record()


def session_without_requests(instrument: Instrument) -> Driver:
    """Return a session on an open line."""
    session = open_driver(instrument)
    session.link_up(0.0)
    return session


def sent_by(session: Driver, name: str, arguments: dict[str, Value]) -> tuple[int, bytes]:
    """Submit a command. Return its request id and first frame; commands are sent before repeated requests."""
    request_id = session.submit(session.encode(name, arguments))
    return request_id, session.poll(0.0)[0]


def talk(session: Driver, unit: OresatUnit, since_s: float, seconds: float) -> list[SessionEvent]:
    """Run both ends in memory. Return the host's events."""
    events: list[SessionEvent] = []
    for k in range(int(seconds * 50)):
        now_s = since_s + 0.02 * k
        for _ in range(200):  # both ends respond immediately
            out, new_events = session.poll(now_s)
            events += new_events
            unit.feed(out, now_s)
            data = b""
            while (record := unit.next_frame(now_s)) is not None:
                data += record
            if not (out or data):
                break
            events += session.feed(data, now_s)
        unit.advance(now_s)
    return events


def stages(events: list[SessionEvent], request_id: int) -> CommandUpdate:
    """Return the last update of a command."""
    return [e for e in events if isinstance(e, CommandUpdate) and e.request_id == request_id][-1]


def telemetry(events: list[SessionEvent], packet: str) -> list[Telemetry]:
    """Return the packets of one name."""
    return [e for e in events if isinstance(e, Telemetry) and e.packet == packet]


def test_requests_and_answers_have_the_public_bytes(oresat: Instrument) -> None:
    """SET_STATUS and its read-back have the public bytes. Another status in the read-back rejects the command."""
    for read, stage in (("4F 00 40 00 04 00 00 00", Stage.COMPLETED), ("4F 00 40 00 02 00 00 00", Stage.REJECTED)):
        session = session_without_requests(oresat)
        request_id, wire = sent_by(session, "SET_STATUS", {"status": "star_track"})
        assert wire == frame(REQUEST, "2F 00 40 00 04 00 00 00")
        session.feed(frame(ANSWER, "60 00 40 00 00 00 00 00"), 0.1)
        assert session.poll(0.1)[0] == frame(REQUEST, "40 00 40 00 00 00 00 00")
        assert stages(session.feed(frame(ANSWER, read), 0.2), request_id).stage is stage


def test_the_time_has_its_public_bytes(oresat: Instrument) -> None:
    """SET_TIME writes seconds and microseconds in the public bytes. The card accepts the same bytes as time on its bus."""
    session, unit = session_without_requests(oresat), unit_of(oresat)
    order = session.encode("SET_TIME", {"seconds": 1_700_000_000, "microseconds": 250_000})
    assert order.payload == bytes.fromhex("00 F1 53 65 90 D0 03 00")
    session.submit(order)
    events = talk(session, unit, 0.0, 1.2)
    assert telemetry(events, "clock")[0].values["seconds"] == 1_700_000_000
    unit.feed(frame(0x181, "00 F1 53 66 90 D0 03 00"), 2.0)
    clock = telemetry(talk(session, unit, 2.0, 1.2), "clock")
    assert clock[-1].values["seconds"] in (1_716_777_216, 1_716_777_217)
    assert abs(clock[-1].device_time_s - 1_716_777_216.25) < 1.1


def test_attitudes_in_process_data_have_the_public_bytes(oresat: Instrument) -> None:
    """The project's example is decoded to right ascension 17.9868°, declination 63.4233° and its roll, which has the
    opposite sign."""
    session = session_without_requests(oresat)
    events = session.feed(
        frame(0x3AC, "04 01 00 2E 93 02")
        + frame(0x4AC, "AC 1E 58 3F CA D6 00 3C")
        + frame(0x1AD, "4B C8 07 3F 41 75 9D BD"),
        0.0,
    )
    packet = telemetry(events, "attitude")[0]
    assert (packet.values["status"], packet.values["known"], packet.values["solve_time"]) == (
        "star_track",
        "solved",
        43_200_000,
    )
    standard = oresat.roles.quantities.attitude.read(packet.values)
    quaternion = np.array([float(standard[f"quaternion_{axis}"]) for axis in "xyzw"])
    ra, dec, roll = np.degrees(ra_dec_roll_rad(matrix_from_quaternion(quaternion)))
    assert (ra, dec, roll) == pytest.approx((17.9868, 63.4233, 360 - 12.238), abs=1e-3)


def test_the_older_dictionary_has_whole_degrees(oresat: Instrument) -> None:
    """Process data of the older dictionary is recognised by its size and gives telemetry in whole degrees, but no
    attitude."""
    events = session_without_requests(oresat).feed(
        frame(0x3AC, "04 67 01 D3 FF 0C 00") + frame(0x4AC, "00 F1 53 65"), 0.0
    )
    values = telemetry(events, "attitude_degrees")[0].values
    assert (values["ra_deg"], values["dec_deg"], values["roll_deg"], values["solve_time"]) == (
        359,
        -45,
        12,
        1_700_000_000,
    )
    assert not telemetry(events, "attitude")


def test_an_incomplete_attitude_or_a_wrong_length_gives_no_attitude(oresat: Instrument) -> None:
    """Incomplete process data, or data of the wrong length, is not combined with data of another solution."""
    session = session_without_requests(oresat)
    first, second, third = frame(0x3AC, "040100F15365"), frame(0x4AC, "0000803F00000000"), frame(0x1AD, "00" * 8)
    for data in (
        first + third,
        second + third,
        first + second + first + third,
        first + second + frame(0x1AD, "0000803F" * 2),
    ):
        assert not telemetry(session.feed(data, 0.0), "attitude")
    assert session.counters.received.undecodable == 1
    assert len(telemetry(session.feed(first + second + third, 0.0), "attitude")) == 1


def test_the_simulated_unit_reports_the_attitude_of_its_motion(oresat: Instrument) -> None:
    """The unit reports the attitude of its motion only in the status star track, with the time of its clock."""
    session, unit = session_without_requests(oresat), unit_of(oresat)
    before = talk(session, unit, 0.0, 2.0)
    assert not telemetry(before, "attitude")
    assert {"housekeeping", "clock", "capture", "card", "updater"} == {
        e.packet for e in before if isinstance(e, Telemetry)
    }
    session.submit(session.encode("SET_STATUS", {"status": "star_track"}))
    attitude = telemetry(talk(session, unit, 2.0, 2.0), "attitude")[-1]
    assert abs(attitude.device_time_s - 1_767_225_603) < 2
    standard = oresat.roles.quantities.attitude.read(attitude.values)
    quaternion = np.array([float(standard[f"quaternion_{axis}"]) for axis in "xyzw"])
    assert np.abs(matrix_from_quaternion(quaternion) - ATTITUDE).max() < 2e-3
    assert standard["outcome"] == "solved"


def test_documented_deviations_can_be_simulated(oresat: Instrument) -> None:
    """Dialects give whole degrees, milliseconds since midnight and a unit that ignores status commands while it boots. An
    unknown dialect is rejected."""
    session, unit = session_without_requests(oresat), unit_of(oresat, OLDER, MIDNIGHT)
    session.submit(session.encode("SET_STATUS", {"status": "star_track"}))
    values = telemetry(talk(session, unit, 0.0, 2.0), "attitude_degrees")[-1].values
    assert (values["ra_deg"], values["dec_deg"]) in [(84, 5), (84, 4), (83, 5), (83, 4)]
    assert int(values["solve_time"]) < 86_400_000
    session, unit = session_without_requests(oresat), unit_of(oresat, BOOTING)
    request_id = session.submit(session.encode("SET_STATUS", {"status": "capture"}))
    ignored = stages(talk(session, unit, 0.0, 0.5), request_id)
    assert (ignored.stage, ignored.reason) == (Stage.REJECTED, "ignored")
    assert "reports boot" in ignored.detail
    assert telemetry(talk(session, unit, BOOT_S, 1.2), "housekeeping")[-1].values["status"] == "standby"
    with pytest.raises(BadInput, match="no such dialect"):
        unit_of(oresat, "other")


def test_a_failed_solve_sends_nothing(oresat: Instrument) -> None:
    """If the unit rotates too fast to solve, its status is star track and no attitude is sent."""
    session, unit = session_without_requests(oresat), unit_of(oresat, rate_rad_s=0.1)
    session.submit(session.encode("SET_STATUS", {"status": "star_track"}))
    events = talk(session, unit, 0.0, 2.5)
    assert telemetry(events, "housekeeping")[-1].values["status"] == "star_track"
    assert not telemetry(events, "attitude")


@pytest.mark.parametrize("dialect", [(), (BLOCK,)])
def test_an_image_is_downloaded_completely(oresat: Instrument, dialect: tuple[str, ...]) -> None:
    """An image is downloaded by block or segmented transfer, while commands wait. A download without an image fails."""
    session, unit = session_without_requests(oresat), unit_of(oresat, *dialect)
    empty = session.transfers.start_download("frame", 0)
    updates = [e for e in talk(session, unit, 0.0, 0.5) if isinstance(e, TransferUpdate) and e.transfer_id == empty]
    assert (updates[-1].state, updates[-1].reason[:23]) == (TransferState.FAILED, "the sensor has no image")
    session.submit(session.encode("SET_STATUS", {"status": "capture"}))
    captured = telemetry(talk(session, unit, 1.0, 4.0), "capture")[-1]
    assert captured.values["last_capture_s"] == 1_767_225_601
    transfer = session.transfers.start_download("frame", 0)
    waiting = session.submit(session.encode("READ_STORAGE", {}))
    events = talk(session, unit, 5.0, 8.0)
    done = next(e for e in events if isinstance(e, TransferDone))
    assert (done.transfer_id, done.sha256) == (transfer, hashlib.sha256(done.data).hexdigest())
    assert Image.open(io.BytesIO(done.data)).size == (640, 480)
    assert dict(stages(events, waiting).values) == {"storage": 12}
    assert session.counters.received.undecodable == session.counters.received.unknown == 0


def test_a_download_survives_silence_and_a_lost_line(oresat: Instrument) -> None:
    """A download waits while the sensor is silent or the line is lost, and starts again when it is resumed. Other kinds
    are rejected."""
    session, unit = session_without_requests(oresat), unit_of(oresat, BLOCK)
    session.submit(session.encode("SET_STATUS", {"status": "capture"}))
    talk(session, unit, 0.0, 2.0)
    transfer = session.transfers.start_download("frame", 0)
    while session.transfer(transfer).state is not TransferState.TRANSFERRING:
        unit.feed(session.poll(2.0)[0], 2.0)
        while (record := unit.next_frame(2.0)) is not None:
            session.feed(record, 2.0)
    for k in range(40):  # the unit no longer responds
        session.poll(2.1 + 0.1 * k)
    update_after_silence = session.transfer(transfer)
    assert (update_after_silence.state, "silent" in update_after_silence.reason) == (TransferState.LINK_LOST, True)
    session.link_lost(8.0)
    session.link_up(9.0)
    session.transfers.pause(transfer)
    talk(session, unit, 9.0, 1.0)
    assert session.transfer(transfer).state is TransferState.PAUSED
    session.transfers.resume(transfer)
    events = talk(session, unit, 14.0, 3.0)
    assert [e.transfer_id for e in events if isinstance(e, TransferDone)] == [transfer]
    with pytest.raises(Conflict, match="cannot send content of type catalogue"):
        session.transfers.start_download("catalogue", 0)
    with pytest.raises(Conflict, match="has ended"):
        session.transfers.abort(transfer)


def test_a_restored_download_continues_when_the_sensor_answers(oresat: Instrument) -> None:
    """After a restart of the server a download waits until the sensor answers. A download that an operator paused remains paused,
    also if it was waiting before."""
    session, unit = session_without_requests(oresat), unit_of(oresat)
    restored, by_operator = (session.transfers.start_download("frame", 0, paused="restarted") for _ in range(2))
    session.transfers.pause(by_operator)
    session.poll(0.0)
    assert session.transfer(restored).state is TransferState.PAUSED
    session.submit(session.encode("SET_STATUS", {"status": "capture"}))
    events = talk(session, unit, 0.0, 8.0)
    assert [e.transfer_id for e in events if isinstance(e, TransferDone)] == [restored]
    assert session.transfer(by_operator).state is TransferState.PAUSED


def test_an_image_is_downloaded_when_the_sensor_stops_taking_images(oresat: Instrument) -> None:
    """In star_track a new image replaces the last one every second. A download waits with the reason, attitudes and commands
    continue, and the last image is downloaded after the sensor has stopped."""
    session, unit = session_without_requests(oresat), unit_of(oresat)
    session.submit(session.encode("SET_STATUS", {"status": "star_track"}))
    talk(session, unit, 0.0, 4.0)
    transfer = session.transfers.start_download("frame", 0)
    stop = session.submit(session.encode("READ_STORAGE", {}))
    events = talk(session, unit, 4.0, 6.0)
    update = session.transfer(transfer)
    assert (update.state, "stops taking images" in update.reason) == (TransferState.QUEUED, True)
    assert stages(events, stop).stage is Stage.COMPLETED
    assert len(telemetry(events, "attitude")) >= 5
    session.submit(session.encode("SET_STATUS", {"status": "standby"}))
    events = talk(session, unit, 10.0, 8.0)
    done = next(e for e in events if isinstance(e, TransferDone))
    assert (done.transfer_id, done.frame_number) == (
        transfer,
        telemetry(events, "capture")[-1].values["last_capture_s"],
    )
    assert session.transfer(transfer).reason == ""


def test_an_image_that_stays_is_downloaded_during_star_track() -> None:
    """With a long pause between images, a download can start although the sensor continues."""
    images = SensorImages(status="star_track")
    images.note_number(7, 100.0)
    assert "stops taking images" in images.wait_reason(100.0 + STEADY_S / 2)
    images.note_number(7, 100.0 + STEADY_S)
    assert images.wait_reason(100.0 + STEADY_S) == ""


def test_abort_codes_reject_the_command(oresat: Instrument) -> None:
    """An SDO abort code rejects the command, with its number and meaning."""
    session = session_without_requests(oresat)
    request_id, _ = sent_by(session, "SET_CAPTURE_COUNT", {"capture_count": 3})
    update = stages(session.feed(frame(ANSWER, "80 01 40 01 02 00 01 06"), 0.1), request_id)
    assert (update.stage, update.reason) == (Stage.REJECTED, "abort_06010002")
    assert "read only" in update.detail


def test_a_read_back_that_fails_does_not_reject_the_command(oresat: Instrument) -> None:
    """If the read-back fails, the command is failed and not rejected, because the sensor accepted the status."""
    session = session_without_requests(oresat)
    request_id, _ = sent_by(session, "SET_STATUS", {"status": "star_track"})
    session.feed(frame(ANSWER, "60 00 40 00 00 00 00 00"), 0.1)
    session.poll(0.1)
    update = stages(session.feed(frame(ANSWER, "80 00 40 00 00 00 00 08"), 0.2), request_id)
    assert (update.stage, update.reason) == (Stage.FAILED, "not_read_back")
    assert session.counters.sent.good == 2


def test_the_status_is_read_from_process_data(oresat: Instrument) -> None:
    """Process data object 3 contains the status, so it is received without a request, also during a download."""
    packet = telemetry(session_without_requests(oresat).feed(frame(0x3AC, "04 01 00 2E 93 02"), 0.0), "housekeeping")[0]
    assert (packet.values["status"], packet.request_id) == ("star_track", 0)


def test_a_dictionary_of_another_sensor_is_rejected_when_the_driver_is_opened(oresat: Instrument) -> None:
    """A dictionary that does not fit the driver is rejected when the session is opened."""
    other_dictionary = dataclasses.replace(oresat.dictionary, telemetry=oresat.dictionary.telemetry[:1])
    with pytest.raises(BadInput, match="does not fit the driver oresat"):
        open_session(UnitSetup(other_dictionary, oresat.link))


class ImageServer:
    """Server of the two objects of an image. ``stops``: number of segments after which it is silent."""

    def __init__(self, content: bytes, stops: int = 1 << 20) -> None:
        self.number, self._content, self._stops = 7, content, stops

    def answer(self, message: bytes) -> list[bytes]:
        """Return the messages that respond to a message of the client."""
        if message[0] == 0x40:
            return [bytes.fromhex("43 01 40 06") + self.number.to_bytes(4, "little")]
        if message[0] == 0xA4:
            return [bytes.fromhex("C2 01 40 05") + len(self._content).to_bytes(4, "little")]  # without a checksum
        if message[0] == 0xA3:
            parts = [self._content[k : k + 7] for k in range(0, len(self._content), 7)]
            block = [bytes([n + 1 | (n + 1 == len(parts)) << 7]) + part.ljust(7, b"\0") for n, part in enumerate(parts)]
            return block[: self._stops]
        return (
            [bytes([0xC1 | (-len(self._content) % 7) << 2]) + bytes(7)]
            if message[0] == 0xA2 and self._stops > 99
            else []
        )


def run_download(downloads: SdoDownloads, client: SdoClient, server: ImageServer, seconds: float) -> None:
    """Run a download with this server for a time."""
    for k in range(int(seconds * 10)):
        out = downloads.poll(0.1 * k) if downloads.holds_channel else downloads.begin(0.1 * k)
        while out:
            replies = [client.feed(answer) for answer in server.answer(out)]
            out = b"".join(replies) or (downloads.poll(0.1 * k) if downloads.holds_channel else b"")


def image_downloads() -> tuple[SdoDownloads, SdoClient]:
    """Return downloads of one object and their client, without a bus."""
    client = SdoClient()
    return SdoDownloads(client, {"frame": PREVIEW}, LAST_CAPTURE, bytes, lambda now_s: ""), client


def test_an_image_has_the_number_that_was_read_before_and_after() -> None:
    """A downloaded image has the number read before and after it. If the number keeps changing, the download fails. The
    server has no checksums."""
    downloads, client = image_downloads()
    downloads.start_download("frame", 0)
    server = ImageServer(bytes(range(100)))
    run_download(downloads, client, server, 1.0)
    done = next(e for e in downloads.news() if isinstance(e, TransferDone))
    assert (done.data, done.frame_number) == (bytes(range(100)), 7)
    transfer = downloads.start_download("frame", 0)
    numbers = iter(range(8, 100))
    serve = server.answer

    def counting(message: bytes) -> list[bytes]:
        server.number = next(numbers) if message[0] == 0x40 else server.number
        return serve(message)

    server.answer = counting  # type: ignore[method-assign]
    run_download(downloads, client, server, 2.0)
    last_update = downloads.update(transfer)
    assert (last_update.state, "another image" in last_update.reason) == (TransferState.FAILED, True)


def test_a_download_that_always_stops_at_the_same_place_fails() -> None:
    """A download that stops three times at the same byte fails."""
    downloads, client = image_downloads()
    transfer = downloads.start_download("frame", 0)
    run_download(downloads, client, ImageServer(bytes(600), stops=9), 60.0)
    last_update = downloads.update(transfer)
    assert (last_update.state, last_update.reason) == (
        TransferState.FAILED,
        "the download stopped 3 times after at most 63 bytes",
    )


def test_only_other_nodes_on_the_bus_are_reported_once(oresat: Instrument) -> None:
    """If only other nodes send, one event reports it, no unit is identified, and commands end as unknown."""
    session = session_without_requests(oresat)
    request_id, _ = sent_by(session, "READ_STATUS", {})
    events: list[SessionEvent] = []
    for k in range(20):
        now_s = k * SILENT_S / 8
        events += session.feed(frame(0x72D, "05") + frame(0x5AD, "4F 00 40 00 02 00 00 00") + frame(0x1AE, "00"), now_s)
        events += session.poll(now_s)[1]
    reports = [e for e in events if isinstance(e, DeviceEvent)]
    assert [(e.name, "0x2D" in e.text) for e in reports] == [("OTHER_NODES_ONLY", True)]
    assert session.hello is None
    assert stages(events, request_id).stage is Stage.UNKNOWN
    assert session.counters.last_good_s is None


def test_faults_and_restarts_of_the_card_are_events(oresat: Instrument) -> None:
    """An emergency message, its end and the boot message of the card are reported as events."""
    data = frame(0x0AC, "00 10 01 00 00 00 00 07") + frame(0x0AC, "00" * 8) + frame(0x72C, "00")
    events = [e for e in session_without_requests(oresat).feed(data, 0.0) if isinstance(e, DeviceEvent)]
    assert [e.name for e in events] == ["EMERGENCY", "EMERGENCY_OVER", "CARD_STARTED"]
    assert "0x1000" in events[0].text


records = st.binary(max_size=40) | st.builds(
    lambda i, d: CanFrame(i, d).record(),
    st.sampled_from([ANSWER, REQUEST, 0x1AC, 0x2AC, 0x3AC, 0x4AC, 0x1AD, 0x0AC, 0x72C, 0x72D, 0x181, 0]),
    st.binary(max_size=8),
)


@settings(deadline=None, max_examples=60)
@given(st.lists(records, max_size=20), st.booleans())
def test_no_bytes_make_either_end_fail(pieces: list[bytes], block: bool) -> None:
    """Random bytes and frames cause no exception in driver or unit, and both work afterwards."""
    instrument = shipped_registry().get("oresat")
    session, unit = session_without_requests(instrument), unit_of(instrument, *([BLOCK] if block else []))
    session.transfers.start_download("frame", 0)
    for k, piece in enumerate(pieces):
        session.feed(piece, 0.1 * k)
        unit.feed(session.poll(0.1 * k)[0] + piece, 0.1 * k)
    while unit.next_frame(0.0) is not None:
        pass
    padding = bytes(16)  # completes a record that random bytes have begun
    session.feed(padding, 9.0)
    unit.feed(padding, 9.0)
    events = talk(session, unit, 10.0, 6.0)
    assert telemetry(events, "clock")
    assert session.hello is not None
