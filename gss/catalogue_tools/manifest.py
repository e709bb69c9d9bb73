"""Manifest of a bank image: inputs, results, and hashes to verify them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import CorruptData
from gss.domain.json_object import JsonObject

MANIFEST_VERSION = 2
LARGEST = 0x7FFF_FFFF
# Fields that were added in version 2. A manifest of version 1 does not contain them.
SINCE_2 = ("corrections", "source_facts", "occultation", "method", "assessment")


@dataclass(frozen=True)
class BuildManifest:
    """All data required to read, check and repeat a build. Angles are in radians; times are ISO 8601, UTC.

    ``hip``: Hipparcos number of each row of the star list. ``valid_to``: "" if the envelope does not drift.
    ``candidates_per_query`` and the quantisation figures are None if the format does not store these values.
    ``corrections``: corrections applied to the stars, with their size. ``source_facts``: origin of the stars.
    ``occultation``: bodies that hide the sky, {} if none. ``method``: method of the envelope. ``assessment``: lifetime
    and ambiguity.
    """

    name: str
    author: str
    tool: str
    format_name: str
    profile_name: str
    profile_sha256: str
    source: str
    star_table_sha256: str
    frame: str
    epoch_jyear: float
    valid_from: str
    valid_to: str
    parameters: JsonObject
    envelope: JsonObject
    counts: dict[str, int]
    bytes_by_part: dict[str, int]
    quality: JsonObject
    quantisation: dict[str, float | None]
    hip: tuple[int, ...]
    image_sha256: str
    corrections: JsonObject = field(default_factory=dict)
    source_facts: JsonObject = field(default_factory=dict)
    occultation: JsonObject = field(default_factory=dict)
    method: str = "exact"
    assessment: JsonObject = field(default_factory=dict)
    version: int = MANIFEST_VERSION

    def as_dict(self) -> JsonObject:
        """Return plain values, including the hash of the manifest."""
        plain = asdict(self)
        if self.version == 1:
            plain = {name: value for name, value in plain.items() if name not in SINCE_2}
        content = json.loads(_canonical(plain))
        return {**content, "manifest_sha256": hashlib.sha256(_canonical(content)).hexdigest()}

    def as_json(self) -> str:
        """Return readable text, identical for identical builds."""
        return json.dumps(self.as_dict(), indent=1, sort_keys=True, ensure_ascii=False)


def read_manifest(text: str) -> BuildManifest:
    """Parse a manifest and verify its hash. Raises CorruptData if it is not valid."""
    try:
        content = json.loads(text)
        claimed = content.pop("manifest_sha256")
        digest = hashlib.sha256(_canonical(content)).hexdigest()
    except (ValueError, KeyError, AttributeError, TypeError, RecursionError) as error:
        raise CorruptData("not a catalogue manifest", expected="JSON with manifest_sha256", got=str(error)) from None
    if claimed != digest:
        raise CorruptData("the manifest was changed after it was written", expected=str(claimed), got=digest)
    names = {f.name for f in fields(BuildManifest)}
    version = content.get("version", "none")
    expected_names = {"1": names - set(SINCE_2), str(MANIFEST_VERSION): names}.get(str(version))
    if expected_names is None or set(content) != expected_names:
        raise CorruptData("a manifest of another version", expected=f"1 or {MANIFEST_VERSION}", got=str(version))
    _check_types(content)
    return BuildManifest(**{**content, "hip": tuple(content["hip"])})


def _check_types(content: Mapping[str, Any]) -> None:
    """Check the type of each value and of its elements. The hash does not ensure valid types, because anyone can
    compute a correct hash."""
    inner: dict[str, Callable[[Any], bool]] = {
        "str": lambda value: isinstance(value, str),
        "int": _whole,
        "float": _number,
        "JsonObject": lambda value: isinstance(value, dict),
        "dict[str, int]": lambda value: isinstance(value, dict) and all(map(_whole, value.values())),
        "dict[str, float | None]": lambda value: (
            isinstance(value, dict) and all(v is None or _number(v) for v in value.values())
        ),
        "tuple[int, ...]": lambda value: isinstance(value, list) and all(map(_whole, value)),
    }
    for f in fields(BuildManifest):
        if f.name in content and not inner[str(f.type)](content[f.name]):
            got = repr(content[f.name])[:60]
            raise CorruptData(f"{f.name} of the manifest is of another type", expected=str(f.type), got=got)


def _whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and -LARGEST <= value <= LARGEST


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def manifest_of(content: Mapping[str, Any]) -> BuildManifest:
    """Return a manifest from stored plain values. Missing fields are empty, for example if the bank was read back from
    a device."""
    empty: JsonObject = {
        "str": "",
        "JsonObject": {},
        "dict": {},
        "tuple": (),
        "float": float("nan"),
        "int": MANIFEST_VERSION,
    }
    values = {f.name: content.get(f.name, empty[str(f.type).partition("[")[0]]) for f in fields(BuildManifest)}
    return BuildManifest(**{**values, "hip": tuple(values["hip"])})


def check_image(manifest: BuildManifest, image: bytes) -> None:
    """Raise CorruptData unless the image is the one that the manifest describes."""
    digest = hashlib.sha256(image).hexdigest()
    if digest != manifest.image_sha256:
        raise CorruptData("the image does not belong to the manifest", expected=manifest.image_sha256, got=digest)


def profile_sha256(profile: CameraProfile) -> str:
    """Return the hash of the part of the profile that a catalogue depends on: the camera's geometry with its
    distortion."""
    camera = asdict(profile.camera)
    camera["distortion"]["model"] = type(profile.camera.distortion).__name__
    return hashlib.sha256(_canonical(camera)).hexdigest()


def _canonical(content: Any) -> bytes:
    return json.dumps(
        content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, default=float, allow_nan=False
    ).encode()
