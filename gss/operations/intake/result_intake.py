"""Intake of the device's results: centroids, matches and attitude of its frames, with the sensor's prior knowledge when it
computed them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from gss.device.session_events import Telemetry
from gss.domain.stars import StarTable
from gss.instruments.telemetry_roles import Quantities
from gss.operations.commanding.command_record import CommandCompleted
from gss.operations.intake.frame_records import FrameRecords
from gss.operations.intake.sensor_knowledge import SensorKnowledge
from gss.operations.line.line_events import LineBatch
from gss.operations.transfers.banks import BankService


class ResultIntake:
    """Collects the result packets of a frame, and tracks the sensor's prior knowledge for its next frame."""

    def __init__(
        self,
        quantities: Quantities,
        records: FrameRecords,
        banks: BankService,
        knowledge: SensorKnowledge,
        stars: StarTable,
    ) -> None:
        self._quantities = quantities
        self._records, self._banks, self._knowledge, self._stars = records, banks, knowledge, stars

    def handle(self, batch: LineBatch) -> None:
        """Process completed commands and result packets."""
        for event in batch.events:
            if isinstance(event, CommandCompleted):
                self._knowledge.completed(event.name, event.arguments)
        for event in batch.events:
            if isinstance(event, Telemetry):
                self._packet(event)

    def _packet(self, event: Telemetry) -> None:
        """Process a result packet. Other packets are ignored."""
        roles = self._quantities
        if event.packet == roles.attitude.packet:
            self._reported("attitude", roles.attitude.read(event.values), ())
        for kind, role in (("centroids", roles.centroids), ("matches", roles.matches)):
            if event.packet == role.packet:
                self._reported(kind, role.read(event.values), event.lists.get(role.items, ()))

    def _reported(self, kind: str, values: Mapping[str, Any], items: Any) -> None:
        if "frame_number" not in values:
            return  # the sensor does not number its frames, so the result cannot be joined with a frame
        number = int(values["frame_number"])
        hips = self._banks.hip_of_row(self._records.settings().get("bank_sha256", ""))
        record = self._records.of(number).with_packet(kind, values, items)
        record = replace(record, hip_of_row=hips, icrs_of_hip=self._stars)
        if kind == "attitude":
            record = replace(record, prior=self._knowledge.prior)
            solved = values.get("outcome") == "solved"
            quaternion = np.array([float(values[f"quaternion_{axis}"]) for axis in "xyzw"]) if solved else None
            self._knowledge.iterated(quaternion, float(values.get("frame_time_s", math.nan)))
        self._records.reported(number, record)
