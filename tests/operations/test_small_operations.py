"""Raw capture, telemetry, pictures, overlays, replay comparison, Sun and Moon, Rerun recording."""

from __future__ import annotations

import io
import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from astropy.coordinates import get_body, get_sun
from astropy.time import Time
from PIL import Image

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.device.session_events import Telemetry
from gss.domain.angles import ra_dec_from_unit, separation_rad, unit_from_ra_dec
from gss.domain.errors import BadInput, NotFound
from gss.domain.frames import cam_from_icrs
from gss.domain.results import Attitude, Centroids, Outcome, SolveResult
from gss.domain.rotation import quaternion_from_matrix
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.registry import shipped_camera
from gss.instruments.roles import default_roles
from gss.operations.frames import overlay, pictures
from gss.operations.frames.onboard_results import OnboardRecord, onboard_result
from gss.operations.frames.replay import compare
from gss.operations.frames.sky import bodies
from gss.operations.line.capture_files import capture_files
from gss.operations.line.line_capture import LineCapture, RawCapture
from gss.operations.line.line_events import LineBatch
from gss.operations.line.raw_capture import RECEIVED, SENT, Retention, read_capture, read_captures
from gss.operations.telemetry.archive import Thinner
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.telemetry.value_format import plain
from gss.store.models import Frame


def test_captured_bytes_are_returned_in_order_without_a_truncated_record(tmp_path):
    """Received and sent bytes are returned exactly. A truncated record is skipped."""
    capture = RawCapture(tmp_path, 7)
    for k, (direction, data) in enumerate([(SENT, b"abc"), (RECEIVED, b"\0\1"), (RECEIVED, b"")]):
        capture.write(100.0 + k, direction, data)
    capture.close()
    (path,) = tmp_path.glob("contact-000007-*.raw")
    data = path.read_bytes()
    assert list(read_capture(io.BytesIO(data))) == [(100.0, SENT, b"abc"), (101.0, RECEIVED, b"\0\1")]
    assert len(list(read_capture(io.BytesIO(data[:-1])))) == 1


def test_captures_rotate_and_the_oldest_is_deleted(tmp_path):
    """The total size of files is bounded, and the newest is not deleted."""
    capture = RawCapture(tmp_path, 1, Retention(1000, 3000))
    for k in range(40):
        capture.write(k, RECEIVED, bytes([k]) * 300)
    capture.close()
    sizes = [p.stat().st_size for p in tmp_path.glob("*.raw")]
    assert sum(sizes) <= 3000 + 2 * 1400
    newest = max(tmp_path.glob("*.raw"), key=lambda p: p.name)
    assert list(read_capture(io.BytesIO(newest.read_bytes())))[-1][2] == bytes([39]) * 300


def test_the_limit_of_captures_applies_across_contacts(tmp_path, monkeypatch):
    """Contacts that each fill less than one file remain within the limit, and so does a contact that continues. A lower limit
    applies immediately. If old files cannot be removed, no record is lost."""
    capture = LineCapture(tmp_path, Retention(1000, 3000), lambda: datetime(2026, 1, 1, tzinfo=UTC), pytest.fail)

    def total() -> int:
        return sum(p.stat().st_size for p in tmp_path.iterdir())

    for contact in (*range(1, 11), *[10] * 10):
        capture.begin(contact)
        capture.write(RECEIVED, bytes(600))
        capture.end()
        assert total() <= 3000 + 613
    capture.keep_at_most(1300)
    assert total() <= 1300
    capture.begin(11)
    monkeypatch.setattr(Path, "unlink", lambda *_, **__: (_ for _ in ()).throw(OSError("read-only")))
    for _ in range(6):
        capture.write(RECEIVED, bytes(600))
    capture.end()
    assert capture.lost_bytes == 0
    assert len(list(read_captures(capture_files(tmp_path, 11)))) == 6


def test_thinning_keeps_every_extreme_and_short_series_unchanged():
    """Thinning keeps the extremes in time order. A short series is unchanged."""
    t, y = [float(k) for k in range(10_000)], [0.0] * 10_000
    y[4321], y[8765] = 9.0, -9.0

    def thin(t, y, points):
        thinner = Thinner(t[0], t[-1], points)
        for sample in zip(t, y, strict=True):
            thinner.take(*sample)
        assert thinner.samples == len(t)
        return thinner.result()

    thin_t, thin_y, thinned = thin(t, y, 200)
    assert thinned
    assert len(thin_t) <= 200
    assert thin_t == sorted(thin_t)
    assert (max(thin_y), min(thin_y)) == (9.0, -9.0)
    assert thin([1.0], [2.0], 10) == ([1.0], [2.0], False)


def test_values_outside_json_become_none():
    """NaN and infinity become None, and bytes hexadecimal text."""
    assert [plain(v) for v in (math.nan, math.inf, 1.5, b"\x0a", "x", True)] == [None, None, 1.5, "0a", "x", True]


@pytest.fixture
def telemetry(database, bus, clock):
    """Telemetry service without packets."""
    return TelemetryService(
        load_dictionary(),
        database,
        bus,
        clock,
        lambda: None,
        lambda: True,
        default_roles(load_dictionary()).quantities.status,
    )


def housekeeping(**values) -> Telemetry:
    """Return a packet with these fields."""
    raw = {"cycle_running": True, "stars_matched": 12, "supply_3v3_v": 3.3, "mode": "tracking"} | values
    return Telemetry("housekeeping", 1.0, 0, raw, raw)


def test_states_follow_limits_age_and_the_running_cycle(telemetry, clock):
    """Values have the state of their limits. Values of a stopped cycle and old values are stale, others "never"."""

    def state(name):
        return next(v.state for v in telemetry.values() if v.name == name and v.packet == "housekeeping")

    assert state("supply_3v3_v") == "never"
    for _ in range(3):
        telemetry.handle(LineBatch((housekeeping(supply_3v3_v=3.45, stars_matched=1),), clock(), 0.0))
    assert (state("supply_3v3_v"), state("stars_matched"), state("mode")) == ("watch", "warning", "ok")
    for _ in range(2):
        telemetry.handle(
            LineBatch((housekeeping(supply_3v3_v=9.9, stars_matched=1, cycle_running=False),), clock(), 0.0)
        )
    assert (state("supply_3v3_v"), state("stars_matched")) == ("critical", "stale")
    telemetry.handle(LineBatch((housekeeping(supply_3v3_v=math.nan),), clock(), 0.0))
    assert state("supply_3v3_v") == "never"
    clock.forward(60)
    assert state("mode") == "stale"


def test_history_returns_a_span_and_rejects_wrong_input(telemetry, clock):
    """Values in time order; an unknown field and an empty span are rejected."""
    for k in range(3):
        telemetry.handle(LineBatch((housekeeping(supply_3v3_v=3.0 + k),), clock(), 0.0))
        clock.forward(1)
    history = telemetry.archive.history
    (series,) = history(["supply_3v3_v"], clock() - timedelta(seconds=9), clock(), 100)
    assert (series.definition.unit, series.y, len(series.t)) == ("V", [3.0, 4.0, 5.0], 3)
    with pytest.raises(NotFound, match="unknown telemetry field"):
        history(["warp"], clock() - timedelta(1), clock(), 10)
    with pytest.raises(BadInput, match="span is empty"):
        history(["mode"], clock(), clock(), 10)


def test_stretch_shows_stars_and_inverts():
    """After the stretch the background is dark and a star bright, or the opposite if inverted. Constant and NaN frames are
    accepted."""
    pixels = np.random.default_rng(1).normal(10, 1, (64, 64)).astype(np.float32)
    pixels[30, 30] = 200
    stretch = pictures.auto_stretch(pixels, None)
    grey = pictures.apply(pixels, stretch)
    assert grey[30, 30] > 240
    assert np.median(grey) < 90
    assert np.array_equal(pictures.apply(pixels, stretch, invert=True), 255 - grey)
    for odd in (np.zeros((5, 3), np.uint8), np.full((4, 4), np.nan, np.float32)):
        assert pictures.apply(odd, pictures.auto_stretch(odd, None)).shape == odd.shape
    picture = Image.open(io.BytesIO(pictures.thumbnail(np.pad(pixels, 300), None)))
    assert max(picture.size) <= 256
    assert np.asarray(picture).max() > 200


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_a_saturated_image_is_bright(bits):
    """An image whose values are the largest of the converter is white, as an image and as a thumbnail. A constant image
    below it is black, and grey if the largest value of the converter is unknown.
    """
    full = np.full((64, 128), 2**bits - 1, np.uint16)
    full_dn = pictures.full_scale_dn(Frame(source="device", bits=bits))
    for pixels, of, grey in ((full, full_dn, 255), (full - 2, full_dn, 0), (full, None, 197), (full - 2, None, 197)):
        shown = pictures.apply(pixels, pictures.auto_stretch(pixels, of))
        small = np.asarray(Image.open(io.BytesIO(pictures.thumbnail(pixels, of))))
        assert abs(int(np.median(shown)) - grey) < 40
        assert np.all(small == grey)


def test_an_imported_file_of_16_bits_does_not_determine_the_converter():
    """Values of a converter with 10 to 14 bits are stored in files of 16 bits. Files of 8 bits and frames of the device
    have the bits of the converter."""
    assert pictures.full_scale_dn(Frame(source="import", bits=16)) is None
    assert pictures.full_scale_dn(Frame(source="import", bits=32)) is None
    assert pictures.full_scale_dn(Frame(source="import", bits=8)) == 255
    assert pictures.full_scale_dn(Frame(source="device", bits=12)) == 4095


ATTITUDE = Attitude(quaternion_from_matrix(cam_from_icrs(*np.radians([84.0, 0.0, 313.0]))), np.eye(3) * 1e-10)


def test_overlay_draws_the_sky_for_the_attitude():
    """Predicted stars, grid and north have the correct positions in the image."""
    camera, stars = shipped_camera("cubestar").camera, load_stars(6.5)
    detail = overlay.describe(camera, stars, 3.8, Centroids.from_pixels(np.zeros((0, 2))), ATTITUDE.cam_from_icrs)
    names = {p["name"] for p in detail["predicted"]}
    assert {"Alnitak", "Alnilam", "Mintaka"} <= names
    assert not any(p["detected"] for p in detail["predicted"])
    betelgeuse = next(p for p in detail["predicted"] if p["name"] == "Betelgeuse")
    on_sky = camera.unproject(np.array([[betelgeuse["col_px"], betelgeuse["row_px"]]])) @ ATTITUDE.cam_from_icrs
    assert separation_rad(on_sky[0], unit_from_ra_dec(*np.radians([88.793, 7.407]))) < np.radians(0.01)
    equator = next(line for line in detail["grid"] if line["label"] == "+0°")
    dec = ra_dec_from_unit(camera.unproject(np.array(equator["points"])) @ ATTITUDE.cam_from_icrs)[1]
    assert np.abs(dec).max() < np.radians(0.02)
    step = np.array(detail["north"])
    assert np.degrees(math.atan2(-step[0], -step[1])) % 360 == pytest.approx(313.0, abs=1e-6)


def result(centroids: np.ndarray, attitude: Attitude | None) -> SolveResult:
    """Return a minimal ground result."""
    outcome = Outcome.NONE if attitude is None else Outcome.SOLVED
    return SolveResult(
        "cubestar",
        outcome,
        "",
        shipped_camera("cubestar").camera,
        (),
        Centroids.from_pixels(centroids),
        None,
        attitude,
        math.nan,
    )


def on_board(centroids: np.ndarray, quaternion=None) -> OnboardRecord:
    """Return the record of the sensor's packets."""
    rows = [
        {"col_px": np.float32(c), "row_px": np.float32(r), "flux_dn": 1.0, "peak_dn": 1, "area_px": 0}
        for c, r in centroids
    ]
    attitude = None
    if quaternion is not None:
        attitude = {f"quaternion_{a}": q for a, q in zip("xyzw", quaternion, strict=True)} | {"outcome": "solved"}
    return OnboardRecord(1, rows, (), attitude)


def test_replay_reports_equal_or_the_first_difference():
    """A replay is equal, or the first difference of centroids, outcome and quaternion is reported. The sign of the
    quaternion is ignored."""
    c, q = np.array([[100.25, 50.5], [300.1, 70.9]]), ATTITUDE.quaternion
    assert compare(on_board(c, q), result(c, ATTITUDE)) == "equal"
    assert compare(on_board(c, -q), result(c, ATTITUDE)) == "equal"
    assert compare(on_board(c), result(c, None)) == "equal"
    assert "1 on board, 2 on the ground" in compare(on_board(c[:1], q), result(c, ATTITUDE))
    assert "centroid 1 differs" in compare(on_board(c + np.array([[0, 0], [0.01, 0]]), q), result(c, ATTITUDE))
    none = replace(on_board(c), attitude={"outcome": "none"})
    assert "outcome differs" in compare(none, result(c, ATTITUDE))
    assert "quaternion differs" in compare(on_board(c, q + 1e-9), result(c, ATTITUDE))


def test_row_numbers_of_an_unknown_bank_are_not_used_as_stars():
    """If the bank is unknown, a note states it. With the bank, rows become Hipparcos numbers."""
    record = on_board(np.array([[10.0, 10.0]]), ATTITUDE.quaternion)
    record = record.with_packet(
        "matches", {}, [{"centroid": 0, "star": 1, "weight": 3.0}, {"centroid": 9, "star": 0, "weight": 1.0}]
    )
    camera = shipped_camera("cubestar").camera
    assert "not available on the ground" in onboard_result(record, camera, "cubestar").notes[0]
    named = onboard_result(replace(record, hip_of_row=[11, 22]), camera, "cubestar")
    assert named.matches.hip.tolist() == [22]
    assert named.outcome is Outcome.NONE, "new matches invalidate an older attitude"


@pytest.mark.parametrize("day", ["2026-03-20", "2026-11-21", "2027-07-01"])
def test_sun_and_moon_of_the_chart_are_near_astropys(day):
    """The Sun is within 0.02° and the Moon within 0.4° of astropy's geocentric positions."""
    at = datetime.fromisoformat(day).replace(tzinfo=UTC)
    sun, moon = bodies(at)
    t = Time(at)
    for body, theirs, tolerance_deg in ((sun, get_sun(t), 0.02), (moon, get_body("moon", t), 0.4)):
        vector = unit_from_ra_dec(theirs.ra.rad, theirs.dec.rad)
        assert np.degrees(separation_rad(body.icrs, vector)) < tolerance_deg
