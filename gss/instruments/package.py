"""Load an instrument: the validated content of a package about one type of sensor."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

from pydantic import ValidationError

from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput, NotFound
from gss.domain.sensor import Defects
from gss.instruments.camera_file import CameraFile
from gss.instruments.dictionary.definitions import Dictionary
from gss.instruments.dictionary.read_dictionary import read_dictionary, shared_dictionary
from gss.instruments.dictionary.read_xtce import dictionary_of
from gss.instruments.link_file import check_protocol
from gss.instruments.marked_yaml import MarkedYaml, parse_yaml
from gss.instruments.package_files import CatalogueFile, InstrumentFile, LinkFile, SimulatorFile
from gss.instruments.package_source import Files, is_package_file
from gss.instruments.quantities import Strict
from gss.instruments.roles import Roles, default_roles, read_roles

OWN_DICTIONARY, XTCE_DICTIONARY, OPERATIONS = "dictionary.yaml", "dictionary.xml", "operations.yaml"
MAX_PROBLEMS = 20
Model = TypeVar("Model", bound=Strict)


@dataclass(frozen=True)
class Instrument:
    """One type of sensor. ``version``: SHA-256 of the canonical content, hexadecimal. ``shipped``: True if the package
    is part of the program. ``roles``: standard operations and quantities. ``catalogue``: None if catalogues cannot be
    uploaded. ``procedures``: Markdown texts by file name."""

    about: InstrumentFile
    version: str
    shipped: bool
    camera: CameraFile
    profile: CameraProfile
    dictionary: Dictionary
    roles: Roles
    link: LinkFile
    catalogue: CatalogueFile | None
    simulator: SimulatorFile | None
    procedures: Mapping[str, str]
    files: Files

    @property
    def name(self) -> str:
        """Name of the instrument in the registry."""
        return self.about.id


def load_instrument(files: Files, *, shipped: bool = False) -> Instrument:
    """Return the instrument in the files of a package. Raises BadInput with file, line and field of each error.

    All files are validated before the function returns, so a partly invalid package is never used.
    """
    unknown = sorted(name for name in files if not is_package_file(name))
    if unknown:
        raise BadInput("a package has no such file", got=", ".join(unknown)[:200])
    for needed in ("instrument.yaml", "camera.yaml"):
        if needed not in files:
            raise BadInput(f"{needed} is missing", expected="at least instrument.yaml and camera.yaml")
    marked = {name: parse_yaml(name, data) for name, data in files.items() if name.endswith(".yaml")}
    about = _checked(marked["instrument.yaml"], InstrumentFile)
    camera = _checked(marked["camera.yaml"], CameraFile)
    link = _optional(marked, "link.yaml", LinkFile) or LinkFile()
    catalogue = _optional(marked, "catalogue.yaml", CatalogueFile)
    simulator = _optional(marked, "simulator.yaml", SimulatorFile)
    dictionary = _dictionary(about, marked["instrument.yaml"], files, link)
    check_protocol(link, dictionary)
    return Instrument(
        about,
        _version(marked, files, dictionary),
        shipped,
        camera,
        _profile(about, camera, catalogue, simulator),
        dictionary,
        read_roles(marked[OPERATIONS], dictionary) if OPERATIONS in marked else default_roles(dictionary),
        link,
        catalogue,
        simulator,
        {name.removeprefix("procedures/"): _text(name, files[name]) for name in files if name.endswith(".md")},
        dict(files),
    )


def read_camera_file(name: str, data: bytes) -> CameraFile:
    """Return the camera in a ``camera.yaml`` outside of a package. Raises BadInput with file, line and field of each
    error."""
    return _checked(parse_yaml(name, data), CameraFile)


def _optional(marked: Mapping[str, MarkedYaml], name: str, model: type[Model]) -> Model | None:
    return _checked(marked[name], model) if name in marked else None


def _checked(file: MarkedYaml, model: type[Model]) -> Model:
    """Validate one file. Raises one BadInput with all errors, one per line."""
    if not isinstance(file.content, dict):
        raise file.error((), "the file must be a mapping of names to values")
    try:
        return model.model_validate(file.content)
    except ValidationError as error:
        places = [
            str(file.error(d["loc"], _reason(d["msg"]), _short(d["input"]) if d["type"] != "value_error" else ""))
            for d in error.errors()[:MAX_PROBLEMS]
        ]
    raise BadInput("\n".join(places))


def _reason(message: str) -> str:
    return message.removeprefix("Value error, ")


def _short(value: object) -> str:
    return "" if isinstance(value, dict | list) else repr(value)[:80]


def _dictionary(about: InstrumentFile, file: MarkedYaml, files: Files, link: LinkFile) -> Dictionary:
    """Return the dictionary in the package (YAML or XTCE), or the shared dictionary that the package names."""
    dictionaries = [name for name in (OWN_DICTIONARY, XTCE_DICTIONARY) if name in files]
    if len(dictionaries) > 1:
        raise BadInput(f"the package has {OWN_DICTIONARY} and {XTCE_DICTIONARY}", expected="only one of these files")
    if about.dictionary is None:
        if not dictionaries:
            raise file.error(
                (), f"name a shared dictionary (dictionary: gss-common) or add {OWN_DICTIONARY} or {XTCE_DICTIONARY}"
            )
        if dictionaries == [XTCE_DICTIONARY]:
            return dictionary_of(XTCE_DICTIONARY, files[XTCE_DICTIONARY], _byte_order(about, link))
        return read_dictionary(OWN_DICTIONARY, files[OWN_DICTIONARY])
    if dictionaries:
        raise file.error(("dictionary",), f"the package has its own {dictionaries[0]}; remove one of the two")
    try:
        return shared_dictionary(about.dictionary)
    except NotFound as error:
        raise file.error(("dictionary",), error.message, about.dictionary) from None


def _byte_order(about: InstrumentFile, link: LinkFile) -> str | None:
    """Return the byte order of the numbers in packets; the driver ``gss`` supports only one. None: only the driver
    defines it."""
    return "big" if about.driver == "gss" else link.content_byte_order


def _profile(
    about: InstrumentFile, file: CameraFile, catalogue: CatalogueFile | None, simulator: SimulatorFile | None
) -> CameraProfile:
    geometry = file.geometry
    sources, defects = file.sources(), Defects()
    if simulator is not None and simulator.defects is not None:
        defects = simulator.defects.defects()
        sources["defects"] = simulator.defects.origin
    rows = catalogue.formats if catalogue is not None else ()
    return CameraProfile(
        name=about.id,
        title=about.title,
        camera=file.camera(),
        sensor=file.sensor(),
        focal_mm=geometry.focal_length.value,
        pitch_col_mm=geometry.pitch_column.value,
        pitch_row_mm=geometry.pitch_row.value,
        f_number=geometry.f_number.value,
        sources=sources,
        defects=defects,
        baffle=file.stray_light(),
        transmission=file.transmission,
        chain=about.chain or "",
        formats=tuple(row.name for row in rows),
        matching_formats=tuple(row.name for row in rows if row.matching),
    )


def _version(marked: Mapping[str, MarkedYaml], files: Files, dictionary: Dictionary) -> str:
    """Return the SHA-256 of the content: YAML files without comments and formatting, texts with normalised line ends,
    and the dictionary, even if it is a shared dictionary."""
    content: dict[str, object] = {name: file.content for name, file in marked.items() if name != OWN_DICTIONARY}
    content |= {name: _text(name, files[name]) for name in files if name.endswith(".md")}
    content["dictionary"] = dictionary.hash_hex
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _text(name: str, data: bytes) -> str:
    try:
        return data.decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise BadInput(f"{name} is not UTF-8 text", got=str(error)) from None
