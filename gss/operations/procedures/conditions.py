"""Evaluation of the conditions of procedures with the latest telemetry."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime

from gss.domain.expressions import Evaluation, parse
from gss.instruments.dictionary.definitions import Value
from gss.operations.procedures.run_record import Values
from gss.operations.telemetry.derived import evaluate
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.telemetry.value_format import plain


class Conditions:
    """Evaluates conditions with the latest packet of each kind. Values of stale packets are missing."""

    def __init__(self, telemetry: TelemetryService) -> None:
        self._telemetry = telemetry

    def evaluate(self, text: str, at: datetime, since: datetime | None = None) -> tuple[Evaluation, Values]:
        """Return the result of a condition at a time, and the values that it used. ``since``: values of packets received before
        this time are missing. Raises BadInput if the text is not valid."""
        expression = parse(text)
        definitions = self._telemetry.derived
        fresh_s = {r.packet: definitions.packet(r.packet).stale_after_s for r in expression.references}

        def received(packet: str) -> tuple[datetime, Mapping[str, Value]] | None:
            latest = self._telemetry.newest_values(packet)
            return None if latest is None or (since is not None and latest[0] < since) else latest

        result, values = evaluate(expression, fresh_s, received, at)
        return result, {name: plain(value) for name, value in values.items()}
