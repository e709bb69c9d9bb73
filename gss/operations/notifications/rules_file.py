"""The file of notification targets and rules (``GSS_NOTIFICATIONS``). The file contains names of environment variables instead
of secrets."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from datetime import datetime, time, timedelta
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, HttpUrl, ValidationError, model_validator

from gss.domain.errors import BadInput
from gss.domain.limits import ORDER, State
from gss.instruments.marked_yaml import parse_yaml

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9 _.-]{0,39}$")]
Address = Annotated[str, Field(pattern=r"^[^\s@<>,;]+@[^\s@<>,;]+$", max_length=254)]
TIME_OF_DAY = re.compile(r"(?:[01][0-9]|2[0-3]):[0-5][0-9](?::[0-5][0-9])?")
Level = Literal["ok", "watch", "warning", "critical"]
Security = Literal["starttls", "tls", "none"]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


def _time_of_day(value: object) -> object:
    if not isinstance(value, str) or not TIME_OF_DAY.fullmatch(value):
        raise ValueError("must be a time in UTC as HH:MM or HH:MM:SS, without a time zone")
    return value


class Mail(_Strict):
    """Mail server and recipients. ``password_env``: name of the environment variable with the password of ``user``."""

    server: Annotated[str, Field(min_length=1, max_length=253)]
    port: Annotated[int, Field(ge=1, le=65535)] = 587
    security: Security = "starttls"
    user: str = ""
    password_env: str = ""
    sender: Address
    to: Annotated[tuple[Address, ...], Field(min_length=1, max_length=50)]

    @model_validator(mode="after")
    def _private_password(self) -> Self:
        if self.user and self.security == "none":
            raise ValueError("user needs security starttls or tls, so that the password is encrypted")
        return self


class Webhook(_Strict):
    """Address that receives JSON by POST. ``secret_env``: name of the environment variable with the signing key."""

    url: HttpUrl
    secret_env: str = ""


class Target(_Strict):
    """One destination of notifications: either mail or a webhook."""

    name: Name
    mail: Mail | None = None
    webhook: Webhook | None = None

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.mail is None) == (self.webhook is None):
            raise ValueError("needs either mail or webhook")
        return self

    @property
    def host(self) -> str:
        """Host that messages are sent to."""
        return self.mail.server if self.mail else str(self.webhook.url.host).strip("[]") if self.webhook else ""

    @property
    def secret_env(self) -> str:
        """Name of the environment variable with the secret; empty if none is needed."""
        return self.mail.password_env if self.mail else self.webhook.secret_env if self.webhook else ""


class Escalation(_Strict):
    """Additional targets of an alarm that is not acknowledged in time."""

    after_min: Annotated[float, Field(gt=0, le=10_080)]
    to: Annotated[tuple[Name, ...], Field(min_length=1)]


class Quiet(_Strict):
    """Hours of the day (UTC) during which messages are delayed, except those of the level ``unless`` or above."""

    start: Annotated[time, BeforeValidator(_time_of_day)]
    end: Annotated[time, BeforeValidator(_time_of_day)]
    unless: Level = "critical"

    def end_after(self, now: datetime) -> datetime | None:
        """Return the end of the current quiet hours, None if ``now`` is not in quiet hours."""
        clock = now.time().replace(tzinfo=None)
        overnight = self.start > self.end
        inside = (clock >= self.start or clock < self.end) if overnight else self.start <= clock < self.end
        if not inside:
            return None
        end = datetime.combine(now.date(), self.end, now.tzinfo)
        return end if end > now else end + timedelta(days=1)


class NotificationRule(_Strict):
    """Rule that sends alarms or events to targets. ``kinds``: kinds of events, as shown on the page *Events*."""

    name: Name
    on: Literal["alarm", "event"] = "alarm"
    level: Level = "warning"
    kinds: tuple[str, ...] = ()
    to: Annotated[tuple[Name, ...], Field(min_length=1)]
    escalate: tuple[Escalation, ...] = ()
    quiet: Quiet | None = None

    @model_validator(mode="after")
    def _fitting(self) -> Self:
        if (self.on == "event") != bool(self.kinds):
            raise ValueError("a rule on events needs kinds, a rule on alarms has none")
        if self.on == "event" and self.escalate:
            raise ValueError("events cannot be acknowledged, so they cannot escalate")
        if "notification" in self.kinds:
            raise ValueError("events about notifications are not sent")
        return self

    @property
    def words(self) -> str:
        """The rule as a sentence."""
        subject = f"events {', '.join(self.kinds)}" if self.on == "event" else "alarms"
        parts = [f"{subject} of level {self.level} or worse to {', '.join(self.to)}"]
        parts += [f"after {e.after_min:g} min without acknowledgement also to {', '.join(e.to)}" for e in self.escalate]
        if self.quiet:
            parts.append(f"waits from {self.quiet.start:%H:%M} to {self.quiet.end:%H:%M} UTC below {self.quiet.unless}")
        return "; ".join(parts)

    def covers(self, level: str) -> bool:
        """True if a level is at least the level of the rule."""
        return level in ORDER and ORDER[State(level)] >= ORDER[State(self.level)]

    def due(self, level: str, now: datetime) -> datetime:
        """Return the earliest time at which a message of this level can be sent."""
        if self.quiet is None or (level in ORDER and ORDER[State(level)] >= ORDER[State(self.quiet.unless)]):
            return now
        return self.quiet.end_after(now) or now


class NotificationRules(_Strict):
    """Content of the file. ``console``: address of the console, shown in messages. ``pause_s``: minimum time between two
    messages to one target; notifications that arrive earlier are combined into one message."""

    console: str = ""
    pause_s: Annotated[float, Field(ge=0, le=86_400)] = 60.0
    targets: tuple[Target, ...] = ()
    rules: tuple[NotificationRule, ...] = ()

    @model_validator(mode="after")
    def _named(self) -> Self:
        for section, names in (("targets", [t.name for t in self.targets]), ("rules", [r.name for r in self.rules])):
            if len(set(names)) != len(names):
                raise ValueError(f"two {section} have the same name")
        target_names = {t.name for t in self.targets}
        used_names = {name for r in self.rules for name in (*r.to, *(n for e in r.escalate for n in e.to))}
        if used_names - target_names:
            raise ValueError(f"no such target: {', '.join(sorted(used_names - target_names))}")
        return self

    def target(self, name: str) -> Target | None:
        """Return the target with this name, None if there is none."""
        return next((t for t in self.targets if t.name == name), None)


def read_rules(file: str, environment: Mapping[str, str] = os.environ) -> NotificationRules:
    """Read and check the file. Return no rules if ``file`` is empty. Raises BadInput with line, field and reason, also if the
    environment does not contain a secret."""
    if not file:
        return NotificationRules()
    path = Path(file)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BadInput(
            "The notifications file cannot be read", got=str(error), hint="check GSS_NOTIFICATIONS"
        ) from error
    marked = parse_yaml(path.name, data)
    try:
        rules = NotificationRules.model_validate(marked.content if marked.content is not None else {})
    except ValidationError as error:
        first = error.errors()[0]
        raise marked.error(first["loc"], first["msg"].removeprefix("Value error, ")) from None
    for k, target in enumerate(rules.targets):
        if target.secret_env and not environment.get(target.secret_env):
            raise marked.error(("targets", k), f"the environment variable {target.secret_env} is not set")
    return rules
