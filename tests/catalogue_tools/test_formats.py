"""Every on-board format byte by byte: encoded bytes, decoded values, rejected input and detected damage."""

import struct
import zlib
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gss.catalogue_tools.formats.registry import blocks_of
from gss.catalogue_tools.onboard import (
    FORMATS,
    base_format,
    core_bytes,
    decode,
    encode,
    encoded_again,
    frame_of,
    image_bytes,
    part_bytes,
    quantisation_error,
    read_header,
    stars_of,
    tables_for,
)
from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.angles import ARCSEC_RAD, unit_from_ra_dec
from gss.domain.errors import BadInput, CorruptData
from gss.instruments.registry import shipped_camera
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.neighbours import neighbour_links
from gss.skytables.pairs import DistanceTable, distance_table
from gss.skytables.sin2 import sin2_directory
from gss.skytables.triplets import CERTAIN, TripletClasses, build_triplets

ROOT = Path(__file__).parent.parent.parent
GOLDEN = ROOT / "tests" / "golden"
MIN_RAD, MAX_RAD = float(np.radians(0.25)), float(np.radians(23))
NO_ROWS = np.empty(0, np.int32)
NEW = ("sunsat-5", "far-mst", "oersted", "aim")


@lru_cache
def sky():
    """Return bright stars of V ≤ 2.0 at J2026.5."""
    return propagate(load_stars(2.0), 2026.5)


@lru_cache
def pairs():
    return distance_table(sky(), MIN_RAD, MAX_RAD)


@lru_cache
def image_of(format_name):
    """Return the image of the bright stars in a format."""
    return encode(sky(), pairs(), format_name, format_name, bytes(range(8)))


@lru_cache
def image_with_sections():
    """Return CubeStar's image with both optional sections, in the frame of Huffman's camera."""
    camera = shipped_camera("far_mst").camera
    encoding = tables_for("cubestar", sky(), pairs(), camera, index=True, reduced=frame_of(camera))
    return encode(sky(), encoding.distances, "cubestar", "cubestar", bytes(range(8)), encoding.tables)


def list_of(unit, v_mag=3.0):
    """Return a star list of directions; other values are unknown."""
    n = len(unit)
    empty = DistanceTable(NO_ROWS, NO_ROWS, np.empty(0), MIN_RAD, MAX_RAD)
    return stars_of(OnboardCatalogue(np.arange(n, dtype=np.int32), unit, np.full(n, v_mag), empty), 2026.5)


def with_checksums(image):
    """Return the image with valid checksums."""
    changed = bytearray(image)
    changed[56:60] = struct.pack("<I", zlib.crc32(changed[64:]))
    changed[60:64] = struct.pack("<I", zlib.crc32(changed[:60]))
    return bytes(changed)


def section_at(image, tag):
    """Return the offset of the content of a section."""
    return image.index(tag.encode()) + 8


# --- bytes ------------------------------------------------------------------------------------------------------------


def test_image_with_sections_equals_the_golden_file():
    """CubeStar's image with k-vector and reduced catalogue equals the stored file byte for byte."""
    assert image_with_sections() == (GOLDEN / "onboard-cubestar-sections.bin").read_bytes()
    assert encoded_again(image_with_sections()) == image_with_sections()
    assert read_header(image_with_sections()).version == 2
    assert read_header(image_of("cubestar")).version == 1


def test_pairs_of_sunsat_5_are_three_numbers_of_13_bits():
    """Jacobs 1995 app. D.1: two cardinals and a distance take five bytes. The test decodes them with integers only."""
    image, n = image_of("sunsat-5"), len(sky())
    at = 64 + 12 * n
    for k in range(len(pairs())):
        word = int.from_bytes(image[at + 5 * k : at + 5 * k + 5], "little")
        fields = (word & 8191, word >> 13 & 8191, word >> 26 & 8191, word >> 39)
        assert fields == (pairs().first[k], pairs().second[k], round(pairs().distance_rad[k] / 50e-6), 0)
    assert len(image) == at + 5 * len(pairs())
    assert image_bytes("sunsat-5", 0, 288_464) / 1e6 == pytest.approx(1.44, abs=0.005)


def test_directory_has_columns_of_sin2_and_a_k_vector():
    """Huffman 2006 §5.5.4: the directory has star numbers and sin²θ. The k-vector counts the pairs that are not above a
    straight line.
    """
    image, n, m = image_of("far-mst"), len(sky()), len(pairs())
    first, second = (struct.unpack_from(f"<{m}H", image, 64 + 14 * n + 2 * m * k) for k in range(2))
    sin2 = struct.unpack_from(f"<{m}f", image, 64 + 14 * n + 4 * m)
    assert np.array_equal(first, pairs().first)
    assert np.array_equal(second, pairs().second)
    assert sin2 == pytest.approx(np.sin(pairs().distance_rad) ** 2, rel=1e-7)
    at = section_at(image, "KVEC")
    start, step = struct.unpack_from("<dd", image, at)
    k = struct.unpack_from(f"<{m}H", image, at + 16)
    assert list(k) == [sum(v <= start + step * t for v in sin2) for t in range(m)]
    v_mmag = struct.unpack_from(f"<{n}h", image, 64 + 12 * n)
    assert np.array_equal(v_mmag, np.rint(sky().v_mag * 1000))


def test_directory_of_the_bank_agrees_with_the_star_list():
    """The bank has the pairs and the sin² of the directory calculated from the star list."""
    directory, decoded = sin2_directory(distance_table(sky(), 0.0, MAX_RAD), len(sky())), decode(image_of("far-mst"))
    stored = directory.sin2 >= np.sin(MIN_RAD) ** 2
    assert np.array_equal(decoded.distances.first, directory.first[stored])
    assert np.array_equal(decoded.distances.second, directory.second[stored])
    assert decoded.tables.sin2 == pytest.approx(directory.sin2[stored], rel=1e-6)


def test_linked_list_has_counts_pointers_and_neighbours():
    """Moniteq 1983 §6.1: a count and a pointer per star, and each link stored at both of its stars, are 8n − 12
    numbers. A star takes 11 bytes.
    """
    image, n = image_of("aim"), len(sky())
    at, links = section_at(image, "LINK"), neighbour_links(sky().icrs)
    count, pointer = (struct.unpack_from(f"<{n}H", image, at + 2 * n * k) for k in range(2))
    near = struct.unpack_from(f"<{6 * n - 12}H", image, at + 4 * n)
    for row in range(n):
        assert near[pointer[row] : pointer[row] + count[row]] == tuple(links.of(row))
    assert part_bytes(image)["LINK"] == 2 * (8 * n - 12)
    assert part_bytes(image)["stars"] == 11 * n
    # The document's catalogue of 3000 stars takes 70 kbyte with links of 12 bits; GSS uses 16.
    assert image_bytes("aim", 3000, 0) == pytest.approx(70e3 + 36e3 * 4 / 12, rel=0.02)


def test_triplets_of_the_bank_agree_with_the_star_list():
    """The decoded sections equal the database computed from the star list. Twelve references take about eight bytes."""
    stars, camera = propagate(load_stars(4.5), 2026.5), shipped_camera("oersted").camera
    encoding = tables_for("oersted", stars, pairs(), camera, limit_mag=4.15, uncertainty_rad=float(np.radians(0.05)))
    image = encode(stars, encoding.distances, "oersted", "oersted", tables=encoding.tables)
    decoded = decode(image).tables.constellations.table()
    classes = TripletClasses.of(float(np.radians(0.05)))
    blend = 3 * camera.pixel_rad
    expected = build_triplets(stars.icrs, stars.v_mag, classes, 4.15, camera.diagonal_rad, blend_rad=blend)
    assert np.array_equal(decoded.key, expected.key)
    assert np.array_equal(decoded.star, expected.star)
    assert (decoded.classes, decoded.limit_mag, decoded.max_rad) == (classes, 4.15, camera.diagonal_rad)
    stored = sum(part_bytes(image)[tag] for tag in ("TCER", "TMAY", "TEXC"))
    assert 10 < 6 * len(expected) / stored < 18


def test_triplets_beyond_the_classes_are_omitted():
    """Neighbours beyond the largest class are omitted, and the image can be decoded."""
    rng = np.random.default_rng(5)
    unit = rng.normal(size=(9, 3))
    stars = list_of(unit / np.linalg.norm(unit, axis=1, keepdims=True))
    wide = shipped_camera("cubestar").camera
    encoding = tables_for(
        "oersted", stars, distance_table(stars, 0.0, 1.0), wide, uncertainty_rad=float(np.radians(20 / 3600))
    )
    image = encode(stars, encoding.distances, "oersted", "any", tables=encoding.tables)
    assert encoded_again(image) == image


def test_certain_triplets_are_one_per_star():
    """The section of always visible stars contains each star at most once."""
    constellations = decode(image_of("oersted")).tables.constellations
    certain = constellations.star[constellations.kind == CERTAIN]
    assert len(certain) > 5
    assert len(np.unique(certain)) == len(certain)


def test_reduced_catalogue_is_decoded_with_its_frame():
    """Huffman 2006 §5.5.4: the decoded reduced catalogue has its stars and the frame for which they were selected."""
    reduced, (width, height) = decode(image_with_sections()).tables.reduced, shipped_camera("far_mst").camera.fov_rad
    assert (reduced.frame.width_rad, reduced.frame.height_rad) == pytest.approx((width, height))
    assert (reduced.frame.brightest, len(reduced.kept)) == (8, len(sky()))
    assert reduced.kept.any()


@pytest.mark.parametrize("format_name", FORMATS)
def test_blocks_cover_the_image(format_name):
    """The blocks, from which tables and C sources are exported, cover every byte of the image once."""
    assert b"".join(data for _, data in blocks_of(image_of(format_name))) == image_of(format_name)
    assert sum(part_bytes(image_of(format_name)).values()) == len(image_of(format_name))


@pytest.mark.parametrize("format_name", ["cubestar", "sunsat", "sunsat-5", "far-mst", "aim"])
def test_image_size_is_predicted(format_name):
    """The predicted size is exact for formats without triplets, whose number depends on the stars."""
    decoded = decode(image_of(format_name))
    assert image_bytes(format_name, len(decoded), len(decoded.distances)) == len(image_of(format_name))


def test_image_size_with_triplets_is_estimated():
    """With triplets, the predicted size is within 20 % for the whole sky to V 4.5."""
    stars = load_stars(4.5)
    encoding = tables_for("oersted", stars, pairs(), shipped_camera("oersted").camera)
    image = encode(stars, encoding.distances, "oersted", "oersted", tables=encoding.tables)
    assert image_bytes("oersted", len(stars), 0) == pytest.approx(len(image), rel=0.2)


# --- error of the number widths --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("format_name", "position_arcsec", "distance_rad", "v_mag"),
    [
        ("sunsat-5", 0.1, 25e-6, 1e-6),
        ("far-mst", 0.02, 1e-6 * ARCSEC_RAD * 1e4, 5e-4 + 1e-6),
        ("oersted", 0.02, 0.0, 5e-4 + 1e-6),
        ("aim", 0.0003, 0.0, 5e-4 + 1e-6),
    ],
)
def test_quantisation_error_is_within_the_widths(format_name, position_arcsec, distance_rad, v_mag):
    """Errors of positions, distances and magnitudes are at most half a step of their encoded numbers."""
    error = quantisation_error(sky(), pairs(), image_of(format_name))
    assert 0 < error.position_rad <= position_arcsec * ARCSEC_RAD
    assert error.distance_rad <= distance_rad * 1.0001
    assert error.v_mag <= v_mag
    if format_name == "sunsat-5":
        assert error.distance_rad > 20e-6


# --- any sky ----------------------------------------------------------------------------------------------------------

near_poles = st.sampled_from([np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-8, -np.pi / 2 + 3e-8, np.float32(np.pi / 2)])
ra_s = st.one_of(st.floats(0, 2 * np.pi), st.sampled_from([0.0, 2 * np.pi, 6.28318525, 1e-9, np.pi]))
dec_s = st.one_of(st.floats(-np.pi / 2, np.pi / 2), near_poles)


@pytest.mark.parametrize("format_name", FORMATS)
@settings(deadline=None)
@given(st.lists(st.tuples(ra_s, dec_s, st.floats(-1.5, 12.0)), min_size=1, max_size=12, unique=True))
def test_any_list_is_decoded_and_encodes_to_the_same_bytes(format_name, ra_dec_mag):
    """Decoded positions agree within 3e-7, also at poles, at RA 0 and for coinciding stars. Encoding again gives the
    same bytes.
    """
    ra, dec, mag = np.array(ra_dec_mag).T
    stars = replace(list_of(unit_from_ra_dec(ra, np.clip(dec, -np.pi / 2, np.pi / 2))), v_mag=mag)
    image = encode(stars, distance_table(stars, 0.0, 0.4), format_name, "any")
    assert encoded_again(image) == image
    decoded = decode(image)
    assert np.abs(decoded.icrs - stars.icrs).max() < 3e-7
    if format_name != "cubestar":  # its banks have no magnitudes
        assert np.abs(decoded.v_mag - mag).max() < 6e-4


# --- damage ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("format_name", [*FORMATS, "sections"])
@settings(deadline=None)
@given(st.data())
def test_any_changed_byte_is_detected(format_name, data):
    """Any change of one byte of the image, followed by erased flash, is detected."""
    image = image_with_sections() if format_name == "sections" else image_of(format_name)
    at = data.draw(st.integers(0, len(image) - 1))
    broken = bytearray(image + b"\xff" * 40)
    broken[at] ^= data.draw(st.integers(1, 255))
    with pytest.raises(CorruptData):
        decode(bytes(broken))


@pytest.mark.parametrize("format_name", [*FORMATS, "sections"])
def test_a_changed_bit_in_every_byte_is_detected(format_name):
    """A changed bit is detected in every byte of the image."""
    image = image_with_sections() if format_name == "sections" else image_of(format_name)
    for at in range(len(image)):
        broken = bytearray(image)
        broken[at] ^= 1 << at % 8
        with pytest.raises(CorruptData):
            decode(bytes(broken))


@pytest.mark.parametrize("format_name", [*FORMATS, "sections"])
def test_every_truncated_image_is_rejected(format_name):
    """A truncated image is rejected at any length; bytes after a complete image have no effect."""
    image = image_with_sections() if format_name == "sections" else image_of(format_name)
    for length in range(64, len(image)):
        with pytest.raises(CorruptData, match="truncated"):
            decode(image[:length])
    for length in range(64):
        with pytest.raises(CorruptData, match="not a bank image"):
            decode(image[:length])
    assert encoded_again(image + b"GSSX" + bytes(range(256))) == image


def damaged(format_name, tag, offset, content):
    """Return an image with changed bytes in a section and valid checksums."""
    image = bytearray(image_with_sections() if tag == "REDU" else image_of(format_name))
    at = section_at(bytes(image), tag) + offset
    image[at : at + len(content)] = content
    return with_checksums(image)


@pytest.mark.parametrize(
    ("format_name", "tag", "offset", "content", "message"),
    [
        ("far-mst", "KVEC", 16 + 2 * 10, b"\xff\xff", "k-vector does not fit"),
        ("far-mst", "KVEC", 0, struct.pack("<d", np.nan), "k-vector does not fit"),
        ("cubestar", "REDU", 16 + 6, b"\xff", "beyond the list"),
        ("aim", "LINK", 0, b"\x63\x00", "pointers"),
        ("aim", "LINK", 4 * 49, b"\xff\x00", "at one end only"),
        ("aim", "LINK", -4, b"\x02\x00\x00\x00", "unknown or misplaced section|wrong length"),
        ("aim", "LINK", -8, b"NOTE", "unknown or misplaced section"),
        ("oersted", "TCLS", 0, struct.pack("<d", 0.0), "classes of the triplets are inconsistent"),
        ("oersted", "TCER", 0, b"\xff\xff", "not in the list"),
        ("oersted", "TCER", -8, b"TCLS", "unknown or misplaced section"),
        ("oersted", "TMAY", -8, b"TCER", "unknown or misplaced section"),
        ("oersted", "TMAY", 2 * 107, b"\x01\x10", "classes of a triplet are out of range"),
    ],
)
def test_invalid_tables_with_valid_checksums_are_rejected(format_name, tag, offset, content, message):
    """An invalid table is rejected although its CRC is valid."""
    with pytest.raises(CorruptData, match=message):
        decode(damaged(format_name, tag, offset, content))


@pytest.mark.parametrize("format_name", ["oersted", "aim"])
def test_an_image_without_required_tables_is_rejected(format_name):
    """Header version 1, which has no sections, is rejected for a format that requires them."""
    core = core_bytes(format_name, len(sky()), 0)
    image = bytearray(image_of(format_name)[:core])
    image[4] = 1
    with pytest.raises(CorruptData, match="lacks required sections"):
        decode(with_checksums(image))


def test_a_set_unused_bit_is_detected():
    """A pair of sunsat-5 whose bit 39 is not zero is rejected."""
    image = bytearray(image_of("sunsat-5"))
    image[64 + 12 * len(sky()) + 4] |= 0x80
    with pytest.raises(CorruptData, match="unused bit"):
        decode(with_checksums(image))


@pytest.mark.parametrize(
    ("format_name", "at", "content", "message"),
    [
        ("sunsat", 64, struct.pack("<f", np.nan), "right ascension is impossible"),
        ("sunsat", 68, struct.pack("<f", 1.7), "declination is impossible"),
        ("aim", 64 + 4 * 49, struct.pack("<i", 2**30 + 1), "declination is impossible"),
        ("far-mst", 64 + 14 * 49 + 4 * 76, struct.pack("<f", -0.1), "sin² is impossible"),
        ("far-mst", 64, struct.pack("<f", 2.0), "not a unit vector"),
        ("sunsat-5", 64 + 12 * 49, b"\xff\x1f", "not in the list"),
    ],
)
def test_invalid_numbers_with_valid_checksums_are_rejected(format_name, at, content, message):
    """Invalid numbers are rejected although the CRC is valid."""
    assert (len(sky()), len(pairs())) == (49, 76)
    image = bytearray(image_of(format_name))
    image[at : at + len(content)] = content
    with pytest.raises(CorruptData, match=message):
        decode(with_checksums(image))


# --- limits ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("format_name", "max_stars"), [("cubestar", 32768), ("sunsat", 65536), ("sunsat-5", 8192), ("aim", 10924)]
)
def test_one_star_too_many_is_rejected(format_name, max_stars):
    """Row numbers of 16 and 13 bits and pointers of 16 bits limit the number of stars.

    More stars are rejected instead of wrapping around.
    """
    rng = np.random.default_rng(1)
    unit = rng.normal(size=(max_stars + 1, 3))
    stars = list_of(unit / np.linalg.norm(unit, axis=1, keepdims=True))
    table = DistanceTable(np.array([0], np.int32), np.array([max_stars - 1], np.int32), np.array([0.1]), 0.0, 0.4)
    with pytest.raises(BadInput, match=f"too many stars for the {format_name} format; expected at most {max_stars}"):
        encode(stars, table, format_name, "any")
    decoded = decode(encode(stars.take(np.arange(max_stars)), table, format_name, "any"))
    assert len(decoded) == max_stars
    if len(decoded.distances):
        assert decoded.distances.second[0] == max_stars - 1


def test_distances_beyond_the_number_range_are_rejected():
    """Distances above 23.46° (13 bits of 50 µrad) or 90° (sin²) are rejected."""
    unit = unit_from_ra_dec(np.radians([0.0, 23.4, 23.5, 95.0]), np.zeros(4))
    for format_name, valid_row, too_far_row in (("sunsat-5", 1, 2), ("far-mst", 2, 3)):
        valid, too_long = (distance_table(list_of(unit[[0, k]]), 0.0, 2.0) for k in (valid_row, too_far_row))
        assert len(decode(encode(list_of(unit[[0, valid_row]]), valid, format_name, "any")).distances) == 1
        with pytest.raises(BadInput, match="too large for the"):
            encode(list_of(unit[[0, too_far_row]]), too_long, format_name, "any")


@pytest.mark.parametrize("format_name", ["far-mst", "oersted", "aim"])
def test_a_magnitude_that_does_not_fit_is_rejected(format_name):
    """Magnitudes above 32.767 do not fit thousandths in 16 bits and are rejected. An unknown magnitude is stored as a
    reserved number.
    """
    stars = list_of(sky().icrs)
    with pytest.raises(BadInput, match="a magnitude does not fit"):
        encode(replace(stars, v_mag=np.full(len(stars), 32.768)), pairs(), format_name, "any")
    unknown = replace(stars, v_mag=np.where(np.arange(len(stars)) == 3, np.nan, 2.5))
    decoded_mag = decode(encode(unknown, pairs(), format_name, "any")).v_mag
    assert np.flatnonzero(np.isnan(decoded_mag)).tolist() == [3]


def test_flags_beyond_eight_bits_are_rejected():
    """AIM stores flags of eight bits. Larger flags are rejected."""
    with pytest.raises(BadInput, match="flags do not fit"):
        encode(replace(sky(), flags=np.full(len(sky()), 256, np.uint16)), pairs(), "aim", "any")
    flags = np.arange(len(sky())).astype(np.uint16)
    assert np.array_equal(decode(encode(replace(sky(), flags=flags), pairs(), "aim", "any")).tables.flags, flags)


@pytest.mark.parametrize("format_name", FORMATS)
def test_a_list_with_nan_is_rejected(format_name):
    """A star list with a direction that is not a unit vector is rejected in every format."""
    icrs = sky().icrs.copy()
    icrs[7] = np.nan
    with pytest.raises(BadInput, match="not a unit vector"):
        encode(replace(sky(), icrs=icrs), pairs(), format_name, "any")


def test_tables_of_another_list_are_rejected():
    """Tables of another star list are rejected."""
    camera = shipped_camera("far_mst").camera
    for format_name in ("far-mst", "oersted"):
        encoding = tables_for(format_name, sky(), pairs(), camera)
        fewer = sky().take(np.arange(len(sky()) - 1))
        with pytest.raises(BadInput, match="another star list"):
            encode(fewer, distance_table(fewer, MIN_RAD, MAX_RAD), format_name, "any", tables=encoding.tables)


def test_pairs_of_another_list_are_rejected():
    """A pair of rows outside the star list is rejected."""
    with pytest.raises(BadInput, match="not in the list"):
        encode(sky().take(np.arange(5)), pairs(), "cubestar", "any")


def test_c_formats_have_their_base_format():
    """The base format of cubestar-c is cubestar. An unknown format is rejected with the list of valid ones."""
    assert base_format("cubestar-c") == "cubestar"
    assert base_format("far-mst") == "far-mst"
    with pytest.raises(BadInput, match=r"cubestar \| sunsat \| sunsat-5 \| far-mst \| oersted \| aim"):
        base_format("punched-tape-c")
