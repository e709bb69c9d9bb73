"""The transfer service, pure: who sends which chunk when, and who holds what."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Compatibility:
    """What an upload says about itself; the device refuses what it cannot use. Zeros where it does not apply (images)."""

    device_model: str = ""
    profile: str = ""
    dictionary_hash: bytes = bytes(32)
    format_version: int = 0
    epoch_jyear: float = 0.0
    stars: int = 0
    pairs: int = 0
