"""The paper that travels with a bank image: what went in, what came out, and hashes to prove it."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, fields
from typing import Any

from gss.catalogue_tools.onboard import BankHeader
from gss.domain.errors import BadInput, CorruptData
from gss.domain.profiles import CameraProfile

MANIFEST_VERSION = 1
SOURCE = "Hipparcos, the new reduction (van Leeuwen 2007, CDS I/311), V and names from d3-celestial (BSD-3)"


@dataclass(frozen=True)
class Manifest:
    """All that is needed to read, check and repeat a build. Angles in radians; times ISO 8601, UTC.

    ``hip``: Hipparcos number of each row of the star list. ``valid_to``: "" where nothing drifts.
    ``candidates_per_query`` and quantisation figures are None where the format has none.
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
    parameters: dict[str, Any]
    envelope: dict[str, Any]
    counts: dict[str, int]
    bytes_by_part: dict[str, int]
    quality: dict[str, Any]
    quantisation: dict[str, float | None]
    hip: tuple[int, ...]
    image_sha256: str
    version: int = MANIFEST_VERSION

    def as_dict(self) -> dict[str, Any]:
        """Plain values, with the manifest's own hash."""
        content = json.loads(_canonical(asdict(self)))
        return {**content, "manifest_sha256": hashlib.sha256(_canonical(content)).hexdigest()}

    def as_json(self) -> str:
        """Readable text, the same for the same build."""
        return json.dumps(self.as_dict(), indent=1, sort_keys=True, ensure_ascii=False)


def read_manifest(text: str) -> Manifest:
    """The manifest of a text, its own hash checked."""
    try:
        content = json.loads(text)
        claimed = content.pop("manifest_sha256")
    except (ValueError, KeyError, AttributeError, TypeError) as error:
        raise CorruptData("not a catalogue manifest", expected="JSON with manifest_sha256", got=str(error)) from None
    found = hashlib.sha256(_canonical(content)).hexdigest()
    if claimed != found:
        raise CorruptData("the manifest was changed after it was written", expected=str(claimed), got=found)
    names = {f.name for f in fields(Manifest)}
    if set(content) != names or content["version"] != MANIFEST_VERSION:
        raise CorruptData(
            "a manifest of another version", expected=str(MANIFEST_VERSION), got=str(content.get("version", "none"))
        )
    return Manifest(**{**content, "hip": tuple(content["hip"])})


def check_image(manifest: Manifest, image: bytes) -> None:
    """The image is the one the manifest describes."""
    found = hashlib.sha256(image).hexdigest()
    if found != manifest.image_sha256:
        raise CorruptData("the image is not the manifest's", expected=manifest.image_sha256, got=found)


def profile_sha256(profile: CameraProfile) -> str:
    """Hash of what a catalogue depends on: the camera's geometry, distortion included."""
    camera = asdict(profile.camera)
    camera["distortion"]["model"] = type(profile.camera.distortion).__name__
    return hashlib.sha256(_canonical(camera)).hexdigest()


def require_profile(header: BankHeader, profile: CameraProfile) -> None:
    """A bank image made for another camera must not be used with this one."""
    if header.profile_name != profile.name or header.profile_hash != bytes.fromhex(profile_sha256(profile))[:8]:
        raise BadInput(
            "the star list was made for another camera",
            expected=f"{profile.name} {profile_sha256(profile)[:16]}",
            got=f"{header.profile_name} {header.profile_hash.hex()}",
            hint="build the catalogue again with this camera's profile",
        )


def _canonical(content: Any) -> bytes:
    return json.dumps(
        content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, default=float, allow_nan=False
    ).encode()
