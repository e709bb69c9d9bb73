"""Every number in a package based on a document states its place in the document, or why it was chosen."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import yaml

from gss.instruments.registry import SHIPPED, shipped_registry

DOCUMENTS = {
    "sunsat": "Jacobs 1995",
    "cubestar": "Erlank 2013",
    "far_mst": "Huffman 2006",
    "oersted": "Liebe 1992",
    "aim": "Moniteq 1983",
}
FILES = ("camera.yaml", "simulator.yaml", "link.yaml", "catalogue.yaml")
# Value and place of each number that a document states. All other numbers were chosen.
FROM_DOCUMENTS: dict[str, dict[str, tuple[float | tuple[float, ...], str]]] = {
    "sunsat": {
        "geometry.columns": (752, "§1.1"),
        "geometry.rows": (582, "§1.1"),
        "geometry.dark_left": (3, "§2.2.1.2"),
        "geometry.dark_right": (40, "§2.2.1.2"),
        "geometry.pitch_column": (0.0065, "§1.1"),
        "geometry.pitch_row": (0.00625, "§1.1"),
        "geometry.focal_length": (25, "§9.1"),
        "geometry.f_number": (1.4, "§9.1"),
        "geometry.centre_column": ((2.64 - 25 * 0.0065) / 0.0065 - 0.5, "eq. F.7"),
        "geometry.centre_row": (581 - ((1.77 - 12 * 0.00625) / 0.00625 - 0.5), "eq. F.7"),
        "lens.tilt": (0.733, "eq. F.8"),
        "lens.tilt_direction": (126, "eq. F.8"),
        "lens.radial": ((0.001, -8e-5, -0.00044), "eq. F.9"),
        "detector.psf_sigma": (1.2, "§9.2.2"),
        "limits.brightest": (2.5, "§6.3"),
        "limits.faintest": (6, "§6.3"),
        "baffle.sun": (28.1, "eq. 7.26"),
        "baffle.earth": (28.1, "eq. 7.26"),
    },
    "cubestar": {
        "geometry.columns": (1024, "Table 3.3"),
        "geometry.rows": (512, "Table 3.3"),
        "geometry.pitch_column": (0.0056, "Table 3.3"),
        "geometry.pitch_row": (0.0056, "Table 3.3"),
        "geometry.focal_length": (6.28, "§5.4"),
        "geometry.f_number": (1.2, "§3.5.4"),
        "lens.k1": (-0.32358, "Fig. 5.12"),
        "lens.k2": (0.12456, "Fig. 5.12"),
        "lens.p1": (0.00414, "Fig. 5.12"),
        "lens.p2": (-0.00624, "Fig. 5.12"),
        "detector.bits": (8, "app. C"),
        "detector.transmission": (0.6, "eq. 3.4.2"),
        "limits.brightest": (-1.5, "§3.5.3"),
        "limits.faintest": (3.8, "§3.5.3"),
        "limits.exposure_max": (0.45, "Table D.2"),
        "limits.exposure": (0.386, "Table D.2"),
    },
    "far_mst": {
        "geometry.columns": (1280, "Table 7.1"),
        "geometry.rows": (1024, "Table 7.1"),
        "geometry.pitch_column": (0.0067, "Table 7.1"),
        "geometry.pitch_row": (0.0067, "Table 7.1"),
        "geometry.focal_length": (15.97, "Table 7.1"),
        "geometry.f_number": (1.597 / (4 * 1.77 / 3.141592653589793) ** 0.5, "Table 7.1"),
        "detector.gain": (10, "Table 7.1"),
        "detector.full_well": (120_000, "§3.2.4"),
        "detector.read_noise": (39, "Table 7.1"),
        "detector.dark_current": (410, "Table 7.1"),
        "detector.psf_sigma": (1.25, "§4.2.2"),
    },
    "oersted": {
        "geometry.columns": (604, "Table 4"),
        "geometry.rows": (576, "Table 4"),
        "geometry.focal_length": (10.94, "Table 4 and Fig. 2"),
        "geometry.f_number": (0.8, "Table 4"),
        "limits.faintest": (4.96, "Star Catalogue"),
        "limits.exposure": (0.8, "Table 4"),
    },
    "aim": {
        "geometry.columns": (256, "§3"),
        "geometry.rows": (256, "§3"),
        "geometry.pitch_column": (0.02, "3.45°"),
        "geometry.pitch_row": (0.02, "3.45°"),
        "geometry.focal_length": (85, "§5.1"),
        "geometry.f_number": (1.4, "§5.1"),
        "detector.bits": (12, "§3.2"),
        "detector.full_well": (1.3e6, "Table 3.1"),
        "detector.read_noise": (73, "Table 4.1"),
        "detector.dark_current": (4000, "Table 4.1"),
        "detector.psf_sigma": (0.45, "§4.2"),
        "detector.quantum_efficiency": (0.157, "Table 4.1"),
        "limits.faintest": (6.5, "§2.1"),
        "limits.exposure_min": (0.01, "Table 7.3"),
        "limits.exposure_max": (10, "Table 7.3"),
        "limits.exposure": (2, "Table 7.3"),
        "baffle.sun": (20, "§5.2"),
        "baffle.earth": (20, "§5.2"),
    },
}


def _without_origin(content: object, path: str = "", stated: bool = False) -> Iterator[str]:
    """Yield the paths of numbers for which neither their mapping nor an enclosing mapping states an origin."""
    if isinstance(content, dict):
        stated = stated or bool(content.get("source") or content.get("chosen"))
        for name, value in content.items():
            yield from _without_origin(value, f"{path}.{name}", stated)
    elif isinstance(content, list):
        for value in content:
            yield from _without_origin(value, path, stated)
    elif isinstance(content, int | float) and not isinstance(content, bool) and not stated:
        yield path


@pytest.mark.parametrize("name", DOCUMENTS)
@pytest.mark.parametrize("file", FILES)
def test_no_number_is_without_origin(name: str, file: str) -> None:
    """In the files for camera, simulated unit, line and catalogue, each number or group of numbers has a source or a
    reason."""
    content = yaml.safe_load((SHIPPED / name / file).read_text("utf-8"))
    assert list(_without_origin(content)) == []


@pytest.mark.parametrize("name", DOCUMENTS)
def test_a_unit_states_its_times_currents_and_defects(name: str) -> None:
    """Each unit states its defects and the origin of its timing and power values; none uses defaults silently."""
    simulator = shipped_registry().get(name).simulator
    assert simulator is not None
    assert simulator.defects is not None
    for row in (simulator.timing, simulator.power):
        assert row.source or row.chosen


@pytest.mark.parametrize("name", DOCUMENTS)
def test_numbers_with_a_source_equal_those_of_the_document(name: str) -> None:
    """Each number with a source has the value that the document states at that place; all other numbers were chosen."""
    expected = FROM_DOCUMENTS[name]
    sourced = {f"{n.part}.{n.name}": n for n in shipped_registry().get(name).camera.numbers() if n.source}
    # Stray light is scaled from Moniteq's table for every camera.
    assert set(sourced) - {"baffle.stray_light"} == set(expected)
    for path, (value, place) in expected.items():
        number = sourced[path]
        assert number.values == pytest.approx(value if isinstance(value, tuple) else (value,), rel=1e-9), path
        assert DOCUMENTS[name] in str(number.source), path
        assert place in str(number.source), path
