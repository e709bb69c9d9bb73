"""Results of the device: centroids, matches and attitude of its frames, with its prior knowledge when it computed them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from gss.device.session_events import Telemetry
from gss.domain.stars import StarTable
from gss.operations.commanding.command_record import CommandCompleted
from gss.operations.intake.frame_records import FrameRecords
from gss.operations.line.line_events import LineBatch
from gss.operations.line.sensor_knowledge import SensorKnowledge
from gss.operations.transfers.banks import BankService

RESULT_PACKETS = ("centroids", "matches", "attitude")


class ResultIntake:
    """Collects the packets of one frame's result, and follows the sensor's prior knowledge for its next frame."""

    def __init__(self, records: FrameRecords, banks: BankService, knowledge: SensorKnowledge, stars: StarTable) -> None:
        self._records, self._banks, self._knowledge, self._stars = records, banks, knowledge, stars

    def handle(self, batch: LineBatch) -> None:
        """Process completed commands and result packets."""
        for event in batch.events:
            if isinstance(event, CommandCompleted):
                self._knowledge.completed(event.name, event.arguments)
        for event in batch.events:
            if isinstance(event, Telemetry) and event.packet in RESULT_PACKETS:
                self._reported(event.packet, event.values, event.lists.get("items", ()))

    def _reported(self, kind: str, values: Mapping[str, Any], items: Any) -> None:
        number = int(values["frame_number"])
        hips = self._banks.hip_of_row(self._records.settings().get("bank_sha256", ""))
        record = self._records.of(number).with_packet(kind, values, items)
        record = replace(record, hip_of_row=hips, icrs_of_hip=self._stars)
        if kind == "attitude":
            record = replace(record, prior=self._knowledge.known)
            solved = values.get("outcome") == "solved"
            quaternion = np.array([float(values[f"quaternion_{axis}"]) for axis in "xyzw"]) if solved else None
            self._knowledge.iterated(quaternion)
        self._records.reported(number, record)
