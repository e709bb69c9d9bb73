"""The ground's model of the sensor's prior knowledge for its next frame: previous attitudes and commanded hints."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from gss.device.protocol.codec import decode, encode_command
from gss.domain.angles import Array
from gss.domain.frames import cam_from_icrs
from gss.domain.rotation import quaternion_from_matrix
from gss.instruments.operations import Operation, StandardOperations
from gss.pipeline.chains.apriori import Apriori, KnownOrbit, PriorState

REMOVES_APRIORI_DEG = 180.0
"""SET_APRIORI with an uncertainty of at least this value withdraws the a-priori angles."""


class SensorKnowledge:
    """Tracks completed commands and reported attitudes. ``prior``: prior knowledge that the sensor uses to match its next
    frame."""

    def __init__(self, operations: StandardOperations) -> None:
        self._operations = operations
        self.prior = PriorState()

    def forget(self) -> None:
        """Reset the prior knowledge, because the device restarted."""
        self.prior = PriorState()

    def iterated(self, quaternion: Array | None, time_s: float) -> None:
        """Update after the iteration of the frame at device time ``time_s``. ``quaternion``: attitude of the frame, None if it was
        not solved."""
        self.prior = self.prior.after(quaternion, time_s)

    def completed(self, name: str, arguments: Mapping[str, Any]) -> None:
        """Update after a completed command."""
        operation = self._operations.of_command(name, arguments)
        if operation is Operation.RESET:
            self.forget()
        elif operation in (Operation.SET_HINT, Operation.SET_ORBIT, Operation.SET_PRIOR):
            received = self._as_received(operation, arguments)
            if operation is Operation.SET_HINT:
                ra, dec, roll = (math.radians(received[f"{a}_deg"]) for a in ("ra", "dec", "roll"))
                quaternion = quaternion_from_matrix(cam_from_icrs(ra, dec, roll))
                radius_rad = math.radians(received["uncertainty_deg"])
                self.prior = replace(self.prior, commanded=quaternion, commanded_radius_rad=radius_rad)
            elif operation is Operation.SET_ORBIT:
                raan, inclination, latitude = (
                    math.radians(received[f"{a}_deg"]) for a in ("raan", "inclination", "latitude")
                )
                orbit = KnownOrbit(raan, inclination, latitude, 1000.0 * received["altitude_km"], received["epoch_s"])
                self.prior = replace(self.prior, orbit=orbit)
            else:
                self.prior = replace(self.prior, apriori=_apriori(received))

    def _as_received(self, operation: Operation, arguments: Mapping[str, Any]) -> Mapping[str, float]:
        """Return the standard arguments that the device receives: with default values, and rounded to the encoded precision."""
        command = self._operations.dictionary.command(self._operations.command(operation))
        payload = encode_command(command, arguments).payload
        received = decode(command.arguments, payload).values
        return {k: float(v) for k, v in self._operations.given(operation, received).items()}


def _apriori(prior_values: Mapping[str, float]) -> Apriori | None:
    if prior_values["uncertainty_deg"] >= REMOVES_APRIORI_DEG:
        return None
    return Apriori(*(math.radians(prior_values[f"{a}_deg"]) for a in ("roll", "pitch", "yaw", "uncertainty")))
