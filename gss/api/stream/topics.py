"""Topics of the event stream: the presenter of each topic, and the message types for the pages.

``StreamTopics`` is part of the OpenAPI document, from which the build generates the types of the pages. A misspelt
topic or an unknown field in a page is therefore a compile error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, get_type_hints

from pydantic import BaseModel, Field, create_model

from gss.api import present
from gss.api.schemas.base import Out
from gss.api.schemas.frames import FrameOut
from gss.store.models import Frame


class DroppedOut(Out):
    """Number of messages that this listener missed."""

    dropped: int


class SessionEndedOut(Out):
    """Why the listener's session or token is no longer valid."""

    ended: str


class LimitsChangedOut(Out):
    """Active limit set, and the field whose limits changed; null: all fields."""

    set: str
    key: str | None


def _frame(frame: Frame) -> FrameOut:
    return present.frames.frame(frame, None)


def _limits(change: Mapping[str, object]) -> LimitsChangedOut:
    return LimitsChangedOut.model_validate(change)


PRESENT: dict[str, Callable[[Any], Any]] = {
    "link": present.link.link,
    "telemetry": present.telemetry.latest,
    "command": present.commands.command,
    "schedule": present.schedule.schedule,
    "procedure_run": present.procedures.run,
    "authority": present.authority.authority,
    "transfer": present.records.transfer,
    "frame": _frame,
    "solution": present.frames.solution,
    "job": present.records.job,
    "event": present.records.event,
    "cycle": present.telemetry.cycle,
    "tables": present.tables.on_board,
    "limits": _limits,
    "alarm": present.alarms.alarm,
    "replay": present.contacts.replay,
    "replay.telemetry": present.telemetry.latest,
    "replay.command": present.contacts.replay_command,
    "replay.event": present.contacts.replay_event,
}
"""Function that converts the payload of each topic to its response model."""
STREAM_TOPICS: dict[str, type[BaseModel]] = {"dropped": DroppedOut, "session": SessionEndedOut}
"""Topics that the stream sends to a single listener."""


def _topics() -> type[BaseModel]:
    models = {topic: get_type_hints(presenter)["return"] for topic, presenter in PRESENT.items()} | STREAM_TOPICS
    fields: dict[str, Any] = {
        topic.replace(".", "_"): (model, Field(alias=topic)) for topic, model in sorted(models.items())
    }
    return create_model("StreamTopics", __base__=Out, __doc__="Type of each message, by its topic.", **fields)


StreamTopics = _topics()
