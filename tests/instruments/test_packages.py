"""Instrument packages: validation names file, line and field; archives are bounded; the version follows the content."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import pytest

from gss.domain.errors import BadInput, Conflict, NotFound
from gss.instruments import registry as registry_module
from gss.instruments.marked_yaml import parse_yaml
from gss.instruments.package import load_instrument
from gss.instruments.package_source import MAX_FILE_BYTES, read_package_files, read_zip, write_folder, write_zip
from gss.instruments.registry import SHIPPED, Registry

CUBESTAR = read_package_files(SHIPPED / "cubestar")


def changed(file: str, old: str, new: str) -> dict[str, bytes]:
    """Return the files of the cubestar package with one text replaced."""
    text = CUBESTAR[file].decode()
    assert old in text
    return {**CUBESTAR, file: text.replace(old, new, 1).encode()}


def renamed(name: str) -> dict[str, bytes]:
    """Return the files of the cubestar package with another name."""
    return changed("instrument.yaml", "id: cubestar", f"id: {name}")


@pytest.mark.parametrize(
    ("file", "old", "new", "field", "reason"),
    [
        ("camera.yaml", "value: 6.28, unit: mm", "value: 6.28, unit: cm", "geometry.focal_length", "unit must be mm"),
        ("camera.yaml", "value: 6.28", "value: -6.28", "geometry.focal_length", "must be between"),
        ("camera.yaml", "value: 6.28", "value: .nan", "geometry.focal_length.value", "finite"),
        ("camera.yaml", "value: 1024", "value: 1024.5", "geometry.columns", "whole number"),
        ("camera.yaml", 'source: "Erlank 2013 §3.5.4"', "origin: x", "geometry.f_number.origin", "not permitted"),
        ("camera.yaml", ', source: "Erlank 2013 §3.5.4"', "", "geometry.f_number", "needs either a source"),
        ("camera.yaml", "model: brown", "model: fisheye", "lens", "fisheye"),
        ("camera.yaml", "faintest: {value: 3.8", "faintest: {value: -3.8", "limits", "brightest must be"),
        ("instrument.yaml", "chain: cubestar", "chain: unheard", "chain", "must be one of"),
        ("instrument.yaml", "dictionary: gss-common", "dictionary: ../secret", "dictionary", "unknown shared"),
        ("instrument.yaml", "id: cubestar", "id: Cube Star", "id", "pattern"),
        ("link.yaml", "framing: cobs", "framing: morse", "framing", "'cobs', 'slip', 'kiss'"),
        ("catalogue.yaml", "name: cubestar", "name: unheard", "formats.0.name", "must be one of"),
        ("simulator.yaml", "hot_share: ", "hot_shares: ", "defects.hot_shares", "not permitted"),
    ],
)
def test_an_error_states_file_line_and_field(file: str, old: str, new: str, field: str, reason: str) -> None:
    """The error states the file, the line of the field in that file, the field's path and the reason."""
    files = changed(file, old, new)
    with pytest.raises(BadInput) as caught:
        load_instrument(files)
    message = str(caught.value)
    lines = files[file].decode().splitlines()
    place = message.split(f"{file}, line ")[1]
    number = int(place.split(":")[0])
    assert field in message
    assert reason in message
    assert field.split(".")[-1] in lines[number - 1] or field.split(".")[-2] in lines[number - 1]


def test_all_errors_of_a_file_are_reported_together() -> None:
    """The error for a file with two wrong units names both fields."""
    text = CUBESTAR["camera.yaml"].decode().replace("unit: mag", "unit: lux")
    with pytest.raises(BadInput) as caught:
        load_instrument({**CUBESTAR, "camera.yaml": text.encode()})
    assert "limits.brightest" in str(caught.value)
    assert "limits.faintest" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("a: &x 1\nb: *x\n", "aliases"),
        ("a: 1\na: 2\n", "appears twice"),
        ("a: [1\n", "not YAML"),
        ("- 1\n", "mapping"),
        ("", "mapping"),
        ("[" * 200 + "]" * 200, "nested"),
        ("a: !!python/object/apply:os.system [x]\n", "this tag is not supported"),
        ("title: !!binary aGVsbG8=\n", "line 1: this tag is not supported"),
        ("references: !!set {a, b}\n", "this tag is not supported"),
        ("<<: {a: 1}\n", "plain text"),
    ],
)
def test_unneeded_yaml_features_are_rejected(text: str, reason: str) -> None:
    """Aliases, duplicate keys, deep nesting, tags and merge keys are rejected with the file's name."""
    with pytest.raises(BadInput, match=r"instrument\.yaml") as caught:
        load_instrument({**CUBESTAR, "instrument.yaml": text.encode()})
    assert reason in str(caught.value)


def test_exponents_without_a_point_are_numbers() -> None:
    """``5e-05`` is a float, as in YAML 1.2."""
    assert (
        load_instrument(changed("simulator.yaml", "dead_share: 2e-05", "dead_share: 3e-05")).profile.defects.dead_share
        == 3e-5
    )


def test_only_true_and_false_are_booleans() -> None:
    """``on``, ``off``, ``yes`` and ``no`` are text, as in YAML 1.2, so that they can be names of arguments."""
    content = parse_yaml("procedure.yaml", b"a: on\nb: [off, yes, No]\nc: true\nd: False\n").content
    assert content == {"a": "on", "b": ["off", "yes", "No"], "c": True, "d": False}


def test_numbers_with_colons_are_text() -> None:
    """``22:00`` is text, as in YAML 1.2, and not the number 1320."""
    content = parse_yaml("rules.yaml", b"a: 22:00\nb: [-1:30, 1:02:03.5, 05:59]\nc: 22\nd: -1.5\n").content
    assert content == {"a": "22:00", "b": ["-1:30", "1:02:03.5", "05:59"], "c": 22, "d": -1.5}


def test_missing_and_unknown_files_are_errors() -> None:
    """A package without camera.yaml, or with a file that is not a package file, is rejected."""
    with pytest.raises(BadInput, match=r"camera\.yaml is missing"):
        load_instrument({k: v for k, v in CUBESTAR.items() if k != "camera.yaml"})
    with pytest.raises(BadInput, match="no such file"):
        load_instrument({**CUBESTAR, "run.py": b"print()"})


def test_the_version_follows_the_content() -> None:
    """Comments and line ends do not change the version; a number or a procedure changes it."""
    version = load_instrument(CUBESTAR).version
    remarks = {name: b"# remark\r\n" if name.endswith(".yaml") else b"" for name in CUBESTAR}
    remarked = {name: remarks[name] + data.replace(b"\n", b"\r\n") for name, data in CUBESTAR.items()}
    assert load_instrument(remarked).version == version
    assert load_instrument(changed("camera.yaml", "value: 6.28", "value: 6.29")).version != version
    assert load_instrument({**CUBESTAR, "procedures/start.md": b"# Start\n"}).version != version
    with_dictionary = {**changed("instrument.yaml", "dictionary: gss-common\n", ""), "dictionary.yaml": DICTIONARY}
    assert load_instrument(with_dictionary).dictionary.hash == load_instrument(CUBESTAR).dictionary.hash


DICTIONARY = (SHIPPED.parent / "dictionary" / "gss-common.yaml").read_bytes()


def test_an_error_in_the_packages_dictionary_states_its_line() -> None:
    """An invalid dictionary.yaml is rejected with file and line, and so is a package with two dictionaries."""
    without_shared = changed("instrument.yaml", "dictionary: gss-common\n", "")
    broken = DICTIONARY.replace(
        b"type: u16, unit: ms, min: 1, max: 2000,", b"type: u12, unit: ms, min: 1, max: 2000,", 1
    )
    with pytest.raises(BadInput, match=r"dictionary\.yaml, line \d+: .*unknown type"):
        load_instrument({**without_shared, "dictionary.yaml": broken})
    with pytest.raises(BadInput, match="remove one of the two"):
        load_instrument({**CUBESTAR, "dictionary.yaml": DICTIONARY})


def archive(entries: dict[str, bytes]) -> bytes:
    """Return a zip archive with these files, without any check of their names."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in entries.items():
            file.writestr(name, data)
    return out.getvalue()


def test_a_link_that_does_not_fit_the_dictionary_is_rejected() -> None:
    """A package whose link.yaml names an unknown packet, or whose framing cannot delimit a packet, is rejected."""
    files = read_package_files(SHIPPED / "nos3")
    unknown = files["link.yaml"].replace(b": housekeeping", b": state")
    with pytest.raises(BadInput, match=r"link\.yaml: unknown telemetry packet"):
        load_instrument({**files, "link.yaml": unknown})
    variable = files["dictionary.yaml"].replace(b"type: u32", b"type: text", 1)
    with pytest.raises(BadInput, match=r"link\.yaml: the framing sync_and_trailer needs packets of fixed size"):
        load_instrument({**files, "dictionary.yaml": variable})


def test_an_archive_gives_the_same_package() -> None:
    """An archive, with or without an enclosing folder, has the same version as its files."""
    version = load_instrument(CUBESTAR).version
    assert load_instrument(read_zip(write_zip("cubestar", CUBESTAR))).version == version
    assert load_instrument(read_zip(archive(dict(CUBESTAR)))).version == version


@pytest.mark.parametrize(
    "name", ["../instrument.yaml", "/instrument.yaml", "a/../../instrument.yaml", "procedures/../x.md", "a\\b.yaml"]
)
def test_an_archive_cannot_contain_outside_paths(name: str) -> None:
    """Absolute paths, paths with ``..`` and paths with backslashes are rejected."""
    with pytest.raises(BadInput, match="no such file"):
        read_zip(archive({**CUBESTAR, name: b"x"}))


def test_a_decompression_bomb_is_rejected() -> None:
    """A small archive that expands to 50 times the file limit, an archive with too many files and an invalid archive
    are rejected."""
    bomb = archive({**CUBESTAR, "procedures/big.md": b"\0" * (50 * MAX_FILE_BYTES)})
    assert len(bomb) < MAX_FILE_BYTES
    with pytest.raises(BadInput, match="too large"):
        read_zip(bomb)
    with pytest.raises(BadInput, match="too many files"):
        read_zip(archive({f"procedures/{n}.md": b"x" for n in range(100)}))
    with pytest.raises(BadInput, match="zip"):
        read_zip(b"PK\3\4 not a zip")


def test_a_link_to_another_file_is_rejected(tmp_path: Path) -> None:
    """A folder with a symbolic link is not read."""
    write_folder(tmp_path / "a", CUBESTAR)
    (tmp_path / "a" / "link.yaml").unlink()
    (tmp_path / "a" / "link.yaml").symlink_to("/etc/passwd")
    with pytest.raises(BadInput, match="symbolic link"):
        read_package_files(tmp_path / "a")


def test_an_added_package_is_found_and_a_changed_one_read_again(tmp_path: Path) -> None:
    """The registry lists an added package immediately, keeps the previous version for comparison, and reads edited
    files again."""
    registry = Registry(tmp_path)
    first = registry.add(renamed("mine"))
    second = registry.add({**renamed("mine"), "procedures/start.md": b"# Start\n"})
    assert registry.get("mine").version == second.version != first.version
    assert registry.versions("mine") == (second.version, first.version)
    assert registry.version("mine", first.version[:8]).files == first.files
    camera = tmp_path / "mine" / "camera.yaml"
    camera.write_bytes(camera.read_bytes().replace(b"value: 6.28", b"value: 12.28"))
    assert registry.camera("mine").focal_mm == 12.28
    assert Registry(tmp_path).get("mine").version == registry.get("mine").version


def test_an_invalid_package_does_not_affect_the_others(tmp_path: Path) -> None:
    """An invalid package is listed as broken with the reason and is not loaded. An invalid or shipped package cannot be
    added."""
    registry = Registry(tmp_path)
    write_folder(tmp_path / "broken", changed("camera.yaml", "value: 6.28", "value: much"))
    write_folder(tmp_path / "other", CUBESTAR)
    assert {b.name for b in registry.broken()} == {"broken", "other"}
    assert "line" in registry.broken()[0].reason
    with pytest.raises(BadInput, match="focal_length"):
        registry.get("broken")
    assert {i.name for i in registry.all()} == set(Registry().names())
    with pytest.raises(BadInput):
        registry.add(changed("camera.yaml", "value: 6.28", "value: much"))
    with pytest.raises(Conflict, match="shipped"):
        registry.add(CUBESTAR)
    with pytest.raises(NotFound, match="unknown instrument"):
        registry.get("unheard")


def test_an_unreadable_package_does_not_affect_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package whose files cannot be read is listed as broken with the reason, until its permissions are changed."""
    registry = Registry(tmp_path)
    registry.add(renamed("mine"))
    with monkeypatch.context() as patch:
        patch.setattr(registry_module, "_signature", _not_permitted)
        assert [b.name for b in registry.broken()] == ["mine"]
        assert "Permission denied" in registry.broken()[0].reason
        assert {i.name for i in registry.all()} == set(Registry().names())
    assert registry.has("mine")


def _not_permitted(folder: Path) -> None:
    raise PermissionError(13, "Permission denied", str(folder))
