"""The ground's model of the sensor's prior knowledge before its next frame: previous attitudes and commanded hints."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from gss.device.dictionary import Dictionary
from gss.device.protocol.codec import check_arguments, decode, encode
from gss.domain.angles import Array
from gss.domain.frames import cam_from_icrs
from gss.domain.rotation import quaternion_from_matrix
from gss.pipeline.chains.apriori import Apriori, Known, KnownOrbit

TAKES_BACK_DEG = 180.0
"""SET_APRIORI with this uncertainty withdraws the a-priori angles."""


class SensorKnowledge:
    """Follows completed commands and reported attitudes. ``known`` is the prior knowledge used to match the next frame."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._dictionary = dictionary
        self.known = Known()

    def forget(self) -> None:
        """Reset the knowledge, because the device restarted."""
        self.known = Known()

    def iterated(self, quaternion: Array | None) -> None:
        """Update after an iteration; ``quaternion`` is None if it gave no attitude."""
        self.known = self.known.after(quaternion)

    def completed(self, name: str, arguments: Mapping[str, Any]) -> None:
        """Update after a completed command."""
        if name == "RESET":
            self.forget()
        elif name in ("SET_ATTITUDE_HINT", "SET_ORBIT", "SET_APRIORI"):
            given = self._as_received(name, arguments)
            if name == "SET_ATTITUDE_HINT":
                ra, dec, roll = (math.radians(given[f"{a}_deg"]) for a in ("ra", "dec", "roll"))
                quaternion = quaternion_from_matrix(cam_from_icrs(ra, dec, roll))
                radius_rad = math.radians(given["uncertainty_deg"])
                self.known = replace(self.known, commanded=quaternion, commanded_radius_rad=radius_rad)
            elif name == "SET_ORBIT":
                raan, inclination, latitude = (
                    math.radians(given[f"{a}_deg"]) for a in ("raan", "inclination", "latitude")
                )
                orbit = KnownOrbit(raan, inclination, latitude, 1000.0 * given["altitude_km"], given["epoch_s"])
                self.known = replace(self.known, orbit=orbit)
            else:
                self.known = replace(self.known, apriori=_apriori(given))

    def _as_received(self, name: str, arguments: Mapping[str, Any]) -> Mapping[str, float]:
        """Return the arguments as the device receives them: with defaults, and rounded to the encoded width."""
        command = self._dictionary.command(name)
        payload = encode(command.arguments, check_arguments(command, arguments))
        return {k: float(v) for k, v in decode(command.arguments, payload).values.items()}


def _apriori(given: Mapping[str, float]) -> Apriori | None:
    if given["uncertainty_deg"] >= TAKES_BACK_DEG:
        return None
    return Apriori(*(math.radians(given[f"{a}_deg"]) for a in ("roll", "pitch", "yaw", "uncertainty")))
