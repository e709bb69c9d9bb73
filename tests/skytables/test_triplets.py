"""Liebe's triplet database: worked example and figures of the document, completeness, and encoding."""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from gss.catalogue_tools.formats.triplet_table import (
    bank_crc32_of,
    decode_triplets,
    encode_triplets,
    figures,
    triplets_of,
)
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.angles import Array
from gss.domain.errors import BadInput, CorruptData
from gss.domain.rotation import matrix_from_quaternion, random_quaternion
from gss.skytables.triplets import (
    TripletClasses,
    TripletTable,
    build_triplets,
    certain_mag,
    faintest_mag,
    features,
    pack,
)

CLASSES = TripletClasses.of(np.radians(0.05))
FIELD_RAD = np.radians(30.0)


@lru_cache
def _table() -> TripletTable:
    return triplets_of(load_stars(faintest_mag(4.5, 0.25)), CLASSES, 4.5, FIELD_RAD)


def _sky(distance_deg: list[float], bearing_deg: list[float], v_mag: list[float]) -> tuple[Array, Array]:
    """Return a star at the pole of a small sky, and its neighbours at these distances and bearings."""
    d, b = np.radians(distance_deg), np.radians(bearing_deg)
    around = np.stack([np.sin(d) * np.cos(b), np.sin(d) * np.sin(b), np.cos(d)], axis=1)
    return np.vstack([[0.0, 0.0, 1.0], around]), np.array([2.0, *v_mag])


def _keys_of(table: TripletTable, star: int) -> set[int]:
    """Return the keys under which a star is stored."""
    return set(table.key[table.star == star].tolist())


def test_the_example_of_the_document_has_eighteen_entries() -> None:
    """The features 5.596°, 8.191° and 164.204° have the classes 54–56, 80–82 and 32–33, the 18 entries of the
    document's table.
    """
    icrs, mag = _sky([5.596, 8.191, 20.0, 21.0], [0.0, 164.204, 90.0, 270.0], [2.0, 2.0, 2.0, 2.0])
    table = build_triplets(icrs, mag, CLASSES, 4.5, FIELD_RAD)
    expected = {int(pack(*map(np.array, (a, b, c)))) for a in (54, 55, 56) for b in (80, 81, 82) for c in (32, 33)}
    assert _keys_of(table, 0) == expected


def test_the_angle_error_agrees_with_the_document() -> None:
    """The angle error for neighbours at 5.596° and 8.191° is the document's ±1.724°."""
    error = CLASSES.angle_error_rad(np.radians(5.596), np.radians(8.191))
    assert np.degrees(error) == pytest.approx(1.724, abs=0.0005)


def test_maybe_stars_give_the_twelve_constellations_of_the_document() -> None:
    """Six neighbours, of which only the third and the sixth are certain, give exactly the twelve constellations of Fig.
    11.
    """
    distance = [5.596, 8.191, 8.6, 10.102, 12.306, 12.754]
    icrs, mag = _sky(distance, [0, 60, 120, 180, 240, 300], [4.6, 4.6, 2.0, 4.6, 4.6, 2.0])
    table = build_triplets(icrs, mag, replace(CLASSES, uncertainty_rad=np.radians(0.001)), 4.5, FIELD_RAD)
    keys = np.array(sorted(_keys_of(table, 0)))
    classes = {(k >> 18, (k >> 6) & 4095) for k in keys.tolist()}
    expected = {(int(distance[i] * 10), int(distance[j] * 10)) for i in range(3) for j in range(i + 1, 6)}
    assert len(expected) == 12
    assert classes == {(a + i, b + j) for a, b in expected for i in (-1, 0, 1) for j in (-1, 0, 1) if a + i <= b + j}


def test_neighbours_of_similar_distance_are_stored_in_both_orders() -> None:
    """A third neighbour within four uncertainties of the second is also stored as the second; one farther away is not
    (Fig. 12, Fig. 13).
    """
    near = _sky([4.0, 6.0, 6.15, 25.0], [0.0, 90.0, 200.0, 300.0], [2.0, 2.0, 2.0, 2.0])
    far = _sky([4.0, 6.0, 6.35, 25.0], [0.0, 90.0, 200.0, 300.0], [2.0, 2.0, 2.0, 2.0])
    angle_of_third = int(160 / 5)
    for sky, present in ((near, True), (far, False)):
        keys = np.array(list(_keys_of(build_triplets(*sky, CLASSES, 4.5, FIELD_RAD), 0)))
        assert bool(np.any((keys & 63) == angle_of_third)) is present


def test_sizes_are_close_to_the_document() -> None:
    """Hipparcos to the same depth gives about 175 000 references in 1 Mbyte (document: 185 000 in 1 Mbyte, about 180
    per star).
    """
    statistics = figures(_table())
    assert statistics.stars == 1300
    assert 165_000 < statistics.references < 195_000
    assert 1.0e6 < statistics.size_bytes < 1.2e6
    assert statistics.stars_per_key < 3


def test_stars_measured_within_the_uncertainty_are_found() -> None:
    """With any set of detected maybe stars and position errors of up to 3′, the features of 99.9 % of the stars lead to
    the star.
    """
    stars = load_stars(faintest_mag(4.5, 0.25))
    rng = np.random.default_rng(4)
    certain = stars.v_mag <= certain_mag(4.5, 0.25)
    recovered = requested = 0
    for _ in range(10):
        rows = np.flatnonzero(certain | (rng.random(len(stars)) < 0.5))
        measured = stars.icrs[rows]
        across = np.cross(measured, rng.normal(size=measured.shape))
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        error = 0.99 * CLASSES.uncertainty_rad * np.sqrt(rng.random(len(measured)))
        measured = np.cos(error)[:, None] * measured + np.sin(error)[:, None] * across
        nearest = np.argsort(-(measured @ measured.T), axis=1)[:, 1:3]
        keys = CLASSES.key(*features(measured, measured[nearest[:, 0]], measured[nearest[:, 1]]))
        measured_row, star = _table().look_up(keys)
        requested += len(rows)
        recovered += len(np.unique(measured_row[star == rows[measured_row]]))
    # The database ends at the second certain neighbour. It omits chains of exchanged neighbours, the last 0.1 %.
    assert recovered >= 0.999 * requested


def test_features_do_not_depend_on_rotation() -> None:
    """A rotation of all stars changes no reference, except features on the edge of a class."""
    stars = load_stars(4.0)
    rotated_icrs = stars.icrs @ matrix_from_quaternion(random_quaternion(np.random.default_rng(1))).T
    original = build_triplets(stars.icrs, stars.v_mag, CLASSES, 3.6, FIELD_RAD)
    rotated = build_triplets(rotated_icrs, stars.v_mag, CLASSES, 3.6, FIELD_RAD)
    pairs = [set(zip(t.key.tolist(), t.star.tolist(), strict=True)) for t in (original, rotated)]
    # Rounding decides the class of a feature that is exactly on an edge.
    assert len(pairs[0] ^ pairs[1]) < 1e-4 * len(original)


def test_close_doubles_are_stored_as_one_and_as_two_stars() -> None:
    """The fainter of two stars within the blend radius is a maybe star: constellations without it are also stored."""
    icrs, mag = _sky([4.0, 4.05, 9.0, 15.0, 16.0], [0.0, 0.2, 90.0, 200.0, 300.0], [2.0, 3.0, 2.0, 2.0, 2.0])
    separate = build_triplets(icrs, mag, CLASSES, 4.5, FIELD_RAD)
    blended = build_triplets(icrs, mag, CLASSES, 4.5, FIELD_RAD, blend_rad=np.radians(0.12))
    without_fainter = int(pack(np.array(40), np.array(90), np.array(18)))
    assert without_fainter not in _keys_of(separate, 0)
    assert without_fainter in _keys_of(blended, 0)


def test_small_lists_give_an_empty_table() -> None:
    """Fewer than three stars have no triplet."""
    stars = load_stars(2.0)
    for n in range(3):
        assert len(build_triplets(stars.icrs[:n], stars.v_mag[:n], CLASSES, 4.5, FIELD_RAD)) == 0


def test_a_list_that_ends_too_bright_is_rejected() -> None:
    """A star list that ends before the detection limit is rejected."""
    with pytest.raises(BadInput, match="ends before"):
        triplets_of(load_stars(4.0), CLASSES, 4.5, FIELD_RAD)


def test_invalid_classes_are_rejected() -> None:
    """Classes without width, or too many for their bits, are rejected."""
    for widths in ((0.0, 0.1, 0.001), (1e-6, 0.1, 0.001), (0.002, 0.01, 0.001), (0.002, 0.1, 0.0)):
        with pytest.raises(BadInput, match="classes"):
            TripletClasses(*widths)


def _small_table() -> TripletTable:
    """Return a table with widths that are exact in binary, so that the golden bytes can be written by hand."""
    key, star = np.array([1, 7, 7, 0x3FFFFFFF], np.uint32), np.array([2, 0, 1, 2], np.int32)
    return TripletTable(key, star, 3, TripletClasses(2**-9, 2**-4, 2**-10), 4.5, 0.25, 0.5)


GOLDEN = (
    "47535354 01 00 4000 03000000 04000000"
    "000000000000603f 000000000000b03f 000000000000503f"
    "00009040 0000803e 0000003f 78563412"
).replace(" ", "")


def test_the_encoded_bytes_are_as_documented() -> None:
    """A small table encodes to the golden bytes, little endian, and zlib confirms both checksums."""
    image = encode_triplets(_small_table(), 0x12345678)
    body = struct.pack("<4I4H", 1, 7, 7, 0x3FFFFFFF, 2, 0, 1, 2)
    assert image[64:] == body
    assert image[:56].hex() == GOLDEN
    assert struct.unpack("<I", image[60:64])[0] == zlib.crc32(image[:60])
    assert struct.unpack_from("<I", image, 56)[0] == zlib.crc32(body)
    assert bank_crc32_of(image) == 0x12345678


def test_encoded_tables_are_decoded() -> None:
    """An encoded table is decoded to the same content. Bytes after it are ignored."""
    table = _table()
    decoded = decode_triplets(encode_triplets(table) + b"\xff" * 100)
    np.testing.assert_array_equal(decoded.key, table.key)
    np.testing.assert_array_equal(decoded.star, table.star)
    assert (decoded.stars, decoded.classes, decoded.limit_mag) == (table.stars, table.classes, table.limit_mag)


def _with_checksums(image: bytes) -> bytes:
    """Return the image with valid checksums for changed content."""
    body = image[64:]
    header = image[:56] + struct.pack("<I", zlib.crc32(body))
    return header + struct.pack("<I", zlib.crc32(header)) + body


def test_every_damage_is_detected() -> None:
    """Truncated, corrupted, unsorted, out-of-range or foreign tables are rejected with the reason."""
    image = encode_triplets(_small_table())
    for bit in range(0, 8 * len(image), 7):
        broken = bytearray(image)
        broken[bit // 8] ^= 1 << bit % 8
        with pytest.raises(CorruptData):
            decode_triplets(bytes(broken))
    for length in (0, 10, 63, len(image) - 1):
        with pytest.raises(CorruptData):
            decode_triplets(image[:length])
    with pytest.raises(CorruptData, match="not sorted"):
        decode_triplets(_with_checksums(image[:64] + struct.pack("<4I4H", 7, 1, 7, 9, 2, 0, 1, 2)))
    with pytest.raises(CorruptData, match="not in the list"):
        decode_triplets(_with_checksums(image[:64] + struct.pack("<4I4H", 1, 7, 7, 9, 2, 0, 1, 3)))
    with pytest.raises(CorruptData, match="unknown kind"):
        decode_triplets(_with_checksums(image[:4] + b"\x02" + image[5:]))
    with pytest.raises(CorruptData, match="inconsistent"):
        decode_triplets(_with_checksums(image[:16] + bytes(8) + image[24:]))


def test_too_many_stars_are_rejected() -> None:
    """More stars than 16-bit row numbers can count are rejected."""
    with pytest.raises(BadInput, match="too many"):
        encode_triplets(replace(_small_table(), stars=70_000))


def test_the_nearest_neighbour_has_the_lower_class() -> None:
    """In every key, the class of the nearest neighbour is at most that of the second one."""
    key = _table().key
    assert np.all((key >> 18) <= ((key >> 6) & 4095))
