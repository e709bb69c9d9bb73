"""The archive: any field over any span, thinned without losing an extreme, and exported as displayed."""

from __future__ import annotations

import csv
import io
import json
from datetime import datetime, timedelta

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import event

from gss.device.session_events import Telemetry
from gss.domain.errors import BadInput, NotFound, StoreDown
from gss.instruments.dictionary.definitions import Conversion, TelemetryField
from gss.instruments.dictionary.read_dictionary import load_dictionary, parse_dictionary
from gss.instruments.roles import default_roles
from gss.operations.line.line_events import LineBatch
from gss.operations.telemetry.archive import Thinner
from gss.operations.telemetry.rollups import buckets
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.telemetry.telemetry_export import export
from gss.operations.telemetry.value_format import raw_of, raw_text
from gss.store import telemetry as store

DICTIONARY = load_dictionary()
MODES = ("standby", "lost_in_space", "tracking")


@pytest.fixture
def telemetry(database, bus, clock):
    """Telemetry service with ten seconds of housekeeping and a centroids packet every two seconds."""
    service = TelemetryService(
        DICTIONARY, database, bus, clock, lambda: None, lambda: True, default_roles(DICTIONARY).quantities.status
    )
    for k in range(10):
        clock.forward(1)
        fields = {
            "supply_3v3_v": 0.001 * (3300 + k),
            "mode": MODES[k % 3],
            "cycle_running": k > 4,
            "latchups": k,
            "catalogue_sha256": bytes([k] * 32),
        }
        packets = [Telemetry("housekeeping", 100.0 + k, 0, fields, fields)]
        if k % 2:
            lists = {"items": ({"col_px": 1.5, "row_px": 2.5, "flux_dn": 9.0, "peak_dn": 7, "area_px": 4},)}
            packets.append(Telemetry("centroids", 100.0 + k, 0, {}, {"frame_number": k}, lists))
        service.handle(LineBatch(tuple(packets), clock(), 0.0))
    return service


def span(clock):
    """Return a span with all stored packets."""
    return clock() - timedelta(hours=1), clock() + timedelta(hours=1)


samples = st.lists(st.one_of(st.none(), st.floats(-1e6, 1e6)), min_size=1, max_size=400)


@given(samples, st.integers(10, 60))
def test_thinning_keeps_order_bound_and_both_extremes(values, points):
    """Thinning returns at most the requested number of samples, in order, with the smallest and the largest value. A short
    series is unchanged."""
    thinner = Thinner(0.0, float(len(values)), points)
    for t, y in enumerate(values):
        thinner.take(float(t), y)
    t, y, thinned = thinner.result()
    assert len(t) == len(y) <= points
    assert t == sorted(t)
    assert thinned == (len(values) > points)
    assert all(values[int(at)] == value for at, value in zip(t, y, strict=True))
    valid_values = [v for v in values if v is not None]
    if valid_values:
        kept_values = [v for v in y if v is not None]
        assert (min(kept_values), max(kept_values)) == (min(valid_values), max(valid_values))


@given(st.lists(st.integers(0, 3), min_size=100, max_size=400), st.integers(10, 60), st.integers(0, 300))
def test_thinned_times_show_the_longer_gaps_and_no_others(values, points, lost):
    """Complete telemetry has no times that are twice the resolution apart, also if adjacent values differ by seconds. A
    longer gap has such times at its ends."""
    span_s = float(len(values) + lost)
    t = [float(k + lost * (k >= 50)) for k in range(len(values))]
    raw, bucketed = Thinner(0.0, span_s, points), Thinner(0.0, span_s, points)
    for at, y in zip(t, values, strict=True):
        raw.take(at, float(y))
    bucketed.merge(buckets(np.array(t), np.array(values, float)))
    for thinner in (raw, bucketed):
        steps = np.diff(thinner.result()[0])
        if lost == 0 or lost > 2 * thinner.resolution_s:
            assert (steps > 2 * thinner.resolution_s).sum() == (lost > 0)


def test_enumerations_and_booleans_of_any_packet_are_plotted_as_numbers(telemetry, clock):
    """An enumeration is plotted as its raw number, a boolean as 0 and 1, and a field of another packet by its full key."""
    mode, running, frame = telemetry.archive.history(
        ["mode", "housekeeping.cycle_running", "centroids.frame_number"], *span(clock), 100
    )
    assert mode.y == [0, 1, 3, 0, 1, 3, 0, 1, 3, 0]
    assert running.y == [0] * 5 + [1] * 5
    assert (frame.packet, frame.y) == ("centroids", [1, 3, 5, 7, 9])
    for key, message in (("catalogue_sha256", "can be plotted"), ("centroids.items", "can be plotted")):
        with pytest.raises(BadInput, match=message):
            telemetry.archive.history([key], *span(clock), 100)
    with pytest.raises(NotFound):
        telemetry.archive.history(["attitude.warp"], *span(clock), 100)
    with pytest.raises(BadInput, match="no field is given"):
        telemetry.archive.history(["mode", "mode"], *span(clock), 100)


def test_a_long_span_is_read_in_blocks_of_bounded_size(telemetry, database, bus, clock):
    """Each statement is limited to a block, and samples at block boundaries are neither lost nor repeated."""
    now = clock()
    fields = {"latchups": 77}
    equal_times = (
        Telemetry("housekeeping", 1.0, 0, fields, fields),
    ) * 7  # with one time: a block boundary between equal times
    telemetry.handle(LineBatch(equal_times, clock(), 0.0))
    sizes: list[int] = []

    def count(_connection, cursor, statement, *_rest) -> None:
        sizes.append(statement.count("LIMIT"))

    event.listen(database.engine, "before_cursor_execute", count)
    rows = list(store.rows(database, "housekeeping", ["latchups"], now - timedelta(hours=1), now, block=3))
    event.remove(database.engine, "before_cursor_execute", count)
    assert [r.values[0] for r in rows] == [*range(10), *[77] * 7]
    assert len({r.id for r in rows}) == 17
    assert len(sizes) == 6
    assert set(sizes) == {1}


def read_csv(pieces) -> list[dict[str, str]]:
    """Return the rows of an export."""
    return list(csv.DictReader(io.StringIO(b"".join(pieces).decode(), newline="")))


KEYS = [
    "supply_3v3_v",
    "mode",
    "cycle_running",
    "latchups",
    "catalogue_sha256",
    "centroids.frame_number",
    "centroids.items",
]


@pytest.mark.parametrize("form", ["converted", "raw", "formatted"])
def test_csv_and_parquet_have_the_same_content(telemetry, clock, form):
    """CSV and Parquet exports have the same values and times in every form."""
    options = {"form": form}
    rows = read_csv(export(telemetry.archive, KEYS, *span(clock), file_format="csv", **options))
    data = b"".join(export(telemetry.archive, KEYS, *span(clock), file_format="parquet", **options))
    table = pq.read_table(io.BytesIO(data)).to_pylist()
    assert len(rows) == len(table) == 15
    for row, other in zip(rows, table, strict=True):
        assert row["received"] == other["received"].isoformat(timespec="milliseconds").replace("+00:00", "Z")
        for key in KEYS:
            value = other[key]
            shown = "" if value is None else str(value).lower() if isinstance(value, bool) else str(value)
            assert row[key] == shown


def test_hdf5_has_the_values_units_and_times_of_csv(telemetry, clock):
    """An HDF5 export has a group per packet with the numbers, texts, booleans, lists, units and times of the CSV export."""
    rows = read_csv(export(telemetry.archive, KEYS, *span(clock), form="converted", file_format="csv"))
    data = b"".join(export(telemetry.archive, KEYS, *span(clock), form="converted", file_format="hdf5"))
    with h5py.File(io.BytesIO(data)) as file:
        assert {name: len(group["received"]) for name, group in file.items()} == {"housekeeping": 10, "centroids": 5}
        housekeeping_rows = [row for row in rows if row["packet"] == "housekeeping"]
        group = file["housekeeping"]
        assert group["supply_3v3_v"][:].tolist() == [float(row["supply_3v3_v"]) for row in housekeeping_rows]
        assert group["supply_3v3_v"].attrs["unit"] == "V"
        assert group["mode"].asstr()[:].tolist() == [row["mode"] for row in housekeeping_rows]
        assert group["cycle_running"][:].tolist() == [0] * 5 + [1] * 5
        stamps = [datetime.fromisoformat(row["received"]).timestamp() for row in housekeeping_rows]
        assert group["received"][:] == pytest.approx(stamps, abs=1e-3)
        assert group["contact"][:].tolist() == [-1] * 10
        assert json.loads(file["centroids"]["items"].asstr()[0])[0]["peak_dn"] == 7


def test_an_hdf5_export_leaves_space_on_the_disk(telemetry, clock, monkeypatch):
    """An HDF5 export is refused before the first piece if the disk of temporary files has too little space. CSV needs no
    space.
    """
    monkeypatch.setattr("gss.operations.telemetry.hdf5_export.SPARE_BYTES", 1 << 62)
    with pytest.raises(StoreDown, match="no room for an HDF5 export"):
        export(telemetry.archive, KEYS, *span(clock), form="converted", file_format="hdf5")
    assert read_csv(export(telemetry.archive, KEYS, *span(clock), form="converted", file_format="csv"))


def test_an_export_equals_the_displayed_values(telemetry, clock):
    """The newest formatted row equals the displayed values. Raw and converted values are those of the packet."""
    shown = {v.name: v for v in telemetry.values() if v.packet == "housekeeping"}
    by_form = {
        form: read_csv(export(telemetry.archive, KEYS[:4], *span(clock), form=form, file_format="csv"))[-1]
        for form in ("converted", "raw", "formatted")
    }
    for key in KEYS[:4]:
        assert by_form["formatted"][key] == shown[key].formatted
    assert by_form["converted"]["supply_3v3_v"] == "3.309"
    assert (by_form["raw"]["supply_3v3_v"], by_form["raw"]["mode"]) == ("3309", "0")


def test_an_invalid_export_is_rejected_before_it_starts(telemetry, clock):
    """An export with an unknown format, form or field, without fields, or with an inverted span is rejected."""
    start, end = span(clock)
    for keys, a, b, form, kind in (
        (["mode"], start, end, "converted", "xls"),
        (["mode"], start, end, "pretty", "csv"),
        (["mode"], end, start, "raw", "csv"),
        ([], start, end, "raw", "csv"),
    ):
        with pytest.raises(BadInput):
            export(telemetry.archive, keys, a, b, form=form, file_format=kind)
    with pytest.raises(NotFound):
        export(telemetry.archive, ["warp"], start, end, form="raw", file_format="csv")


def test_an_empty_span_gives_an_empty_file_with_its_columns(telemetry, clock):
    """An export of a span without packets has its columns and no rows."""
    start, end = clock() + timedelta(days=1), clock() + timedelta(days=2)
    assert read_csv(export(telemetry.archive, KEYS, start, end, form="raw", file_format="csv")) == []
    data = b"".join(export(telemetry.archive, KEYS, start, end, form="raw", file_format="parquet"))
    table = pq.read_table(io.BytesIO(data))
    assert table.num_rows == 0
    assert table.column_names[4:] == [*KEYS, "other_values"]
    data = b"".join(export(telemetry.archive, KEYS, start, end, form="raw", file_format="hdf5"))
    with h5py.File(io.BytesIO(data)) as file:
        assert file["housekeeping"]["mode"].shape == (0,)


@pytest.mark.parametrize(
    ("key", "raws"),
    [
        ("sensor_temperature_c", (0, 1, 1607, 65535)),
        ("processor_temperature_c", (0, 900, 40000, 65535)),
        ("mode", (0, 3)),
    ],
)
def test_raw_values_are_recovered_exactly(key, raws):
    """Raw values are recovered from linear and polynomial conversions and enumerations. Other values have no raw value."""
    field = next(f for f in DICTIONARY.packet("housekeeping").values if f.name == key)
    for raw in raws:
        value = field.choice_name(raw) if field.choices else field.conversion.engineering(raw)
        assert raw_of(field, value) == raw
    if not field.choices:
        assert raw_of(field, 12.345678) is None
        assert raw_text(field, 1607) == "0x0647"


@pytest.mark.parametrize(
    ("kind", "coefficients", "pairs"),
    [
        ("i16", (0.0, 0.0, 1.0), {0: 0, 5: None, -5: None, -32768: -32768}),
        ("u8", (0.0, 200.0, -1.0), {100: 100, 60: None, 140: None, 255: 255}),
        ("u8", (0.0, 0.0, 1.0), {k: k for k in range(256)}),
        ("u64", (0.0, 1e-6), {5: 5, 2**63 + 12345: None}),
        ("u8", (7.0,), {3: None}),
    ],
)
def test_a_raw_value_is_unknown_unless_it_is_the_only_one(kind, coefficients, pairs):
    """A raw value is recovered only if the conversion gives no other raw value the same engineering value."""
    field = TelemetryField(name="t", type=kind, conversion=Conversion(coefficients))
    assert {raw: raw_of(field, field.conversion.engineering(raw)) for raw in pairs} == pairs


@pytest.mark.parametrize("form", ["converted", "raw"])
def test_unsigned_numbers_of_64_bits_are_exported_exactly(database, bus, clock, form):
    """Numbers above 2⁶³, and numbers that a float64 cannot hold, are equal in CSV, Parquet and HDF5."""
    text = (
        "version: 1\ndevice_model: m\ncommands: []\nevents: []\nservices: []\ntelemetry:\n"
        "  - {name: p, code: 1, purpose: p, stale_after_s: 5, fields: [{name: n, type: u64}]}\n"
    )
    dictionary, numbers = parse_dictionary(text), [5, 2**53 + 1, 2**63, 2**64 - 2]
    status = default_roles(DICTIONARY).quantities.status
    service = TelemetryService(dictionary, database, bus, clock, lambda: None, lambda: True, status)
    packets = [Telemetry("p", float(k), 0, {"n": n}, {"n": n}) for k, n in enumerate(numbers)]
    service.handle(LineBatch(tuple(packets), clock(), 0.0))

    def exported(file_format):
        return export(service.archive, ["p.n"], *span(clock), form=form, file_format=file_format)

    assert [int(row["p.n"]) for row in read_csv(exported("csv"))] == numbers
    assert pq.read_table(io.BytesIO(b"".join(exported("parquet"))))["p.n"].to_pylist() == numbers
    with h5py.File(io.BytesIO(b"".join(exported("hdf5")))) as file:
        assert [int(n) for n in file["p/n"][:]] == numbers


def test_an_export_has_no_device_time_if_the_sensor_reports_none(telemetry, clock):
    """A device time of 0 is empty in CSV, null in Parquet and NaN in HDF5."""
    telemetry.handle(LineBatch((Telemetry("housekeeping", 0.0, 0, {"latchups": 10}, {"latchups": 10}),), clock(), 0.0))

    def exported(file_format):
        return export(
            telemetry.archive, ["housekeeping.latchups"], *span(clock), form="converted", file_format=file_format
        )

    assert [row["device_time_s"] for row in read_csv(exported("csv"))[-2:]] == ["109.0", ""]
    assert pq.read_table(io.BytesIO(b"".join(exported("parquet"))))["device_time_s"].to_pylist()[-2:] == [109.0, None]
    with h5py.File(io.BytesIO(b"".join(exported("hdf5")))) as file:
        assert np.isnan(file["housekeeping/device_time_s"][-1])


def test_packets_are_paged_newest_first(telemetry):
    """Packets are listed with their lists, newest first, and a page continues where the previous one ended."""
    first = telemetry.archive.packets("centroids", None, None, 2, None)
    second = telemetry.archive.packets("centroids", None, None, 9, first[-1].id)
    assert [r.values["frame_number"] for r in [*first, *second]] == [9, 7, 5, 3, 1]
    assert first[0].values["items"][0]["col_px"] == 1.5
