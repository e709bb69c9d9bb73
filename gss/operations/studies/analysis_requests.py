"""Requests for analyses in user units, for the API and the job store."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from gss.domain.errors import BadInput
from gss.domain.json_object import JsonObject
from gss.operations.frames.solve import CHAINS
from gss.operations.jobs import JobRequest
from gss.operations.requests import Id, Request
from gss.operations.studies.analyse import check_kind
from gss.operations.studies.moving_objects import CameraPlace, place_of
from gss.orbit.objects import read_objects
from gss.orbit.read_orbit import MAX_CHARACTERS, read_orbits
from gss.orbit.trajectory import Trajectory

MAX_FRAMES = 5000
MOUNTING_SLACK = 1e-3
ManyIds = Annotated[list[Id], Field(max_length=MAX_FRAMES)]


def check_chain(name: str) -> None:
    """Raise BadInput for an unknown chain."""
    if name not in CHAINS:
        raise BadInput("unknown chain", expected=" | ".join(CHAINS), got=name)


def check_different(ids: Sequence[int]) -> None:
    """Raise BadInput if a frame id occurs twice."""
    if len(set(ids)) != len(ids):
        raise BadInput("frames cannot be used", expected="different frames", got=f"{len(ids)} with duplicates")


class FrameAnalysis(Request):
    """Analysis of stored frames. ``profile``: camera of the frames; ``commanded_deg_s``: commanded rate of a slew;
    ``other_*``: second camera, only for two-cameras."""

    kind: Literal["earth-fixed", "celestial-fixed", "slew", "sensitivity", "nea", "spatial", "two-cameras"]
    profile: str = Field(max_length=40)
    frame_ids: ManyIds
    chain: str = Field(default="reference", max_length=30)
    commanded_deg_s: float | None = Field(default=None, gt=0, lt=20)
    other_profile: str = Field(default="", max_length=40)
    other_ids: ManyIds = Field(default=[])
    title: str = Field(default="", max_length=120)

    @property
    def commanded_rad_s(self) -> float | None:
        """Commanded rate of a slew in radians per second."""
        return None if self.commanded_deg_s is None else math.radians(self.commanded_deg_s)

    @model_validator(mode="after")
    def _possible(self) -> Self:
        check_kind(self.kind, self.commanded_rad_s, len(self.other_ids))
        check_chain(self.chain)
        check_different(self.frame_ids)
        check_different(self.other_ids)
        if not self.frame_ids:
            raise BadInput("no frames given", expected="frames of one night")
        return self


class TelemetryAnalysis(Request):
    """Performance analysis of the attitudes of a contact."""

    kind: Literal["telemetry"]
    contact: Id
    title: str = Field(default="", max_length=120)


class SheetRequest(Request):
    """Performance sheet of stored frames, of a simulated unit, or of the attitudes and star lists that the sensor
    reported during a contact. ``chain``: empty for the chain of the unit, or the reference chain if it has none.
    ``other_*``: frames of a second head on the same body, taken at the same times; ``mounting``: quaternion camera from
    second head, scalar last, as measured on the ground."""

    kind: Literal["sheet"]
    profile: str = Field(max_length=40)
    simulated: bool = False
    contact: Id | None = None
    frame_ids: ManyIds = Field(default=[])
    chain: str = Field(default="", max_length=30)
    other_profile: str = Field(default="", max_length=40)
    other_ids: ManyIds = Field(default=[])
    mounting: Annotated[list[Annotated[float, Field(ge=-1, le=1)]], Field(min_length=4, max_length=4)] | None = None
    seed: int = Field(default=1, ge=0, le=2**31 - 1)
    title: str = Field(default="", max_length=120)

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.chain:
            check_chain(self.chain)
        check_different(self.frame_ids)
        check_different(self.other_ids)
        inputs = sum((self.simulated, bool(self.frame_ids), self.contact is not None))
        if inputs != 1:
            raise BadInput(
                "a performance sheet needs frames, a simulated unit or a contact",
                expected="one of these inputs",
                got="none" if inputs == 0 else str(inputs),
            )
        if self.other_ids and (not self.frame_ids or not self.other_profile):
            raise BadInput(
                "the input of a second head is incomplete",
                expected="the profile and frames of the second head, and frames of the unit",
            )
        if self.mounting is not None and abs(math.hypot(*self.mounting) - 1) > MOUNTING_SLACK:
            raise BadInput("the mounting is not a unit quaternion", got=f"length {math.hypot(*self.mounting):g}")
        return self


class MovingRequest(Request):
    """Moving objects in stored frames of one sequence. ``objects``: two-line elements of objects to identify;
    ``orbit``: TLE, OMM or OEM of the spacecraft with the camera; ``site``: latitude and longitude in degrees and height
    in metres of a camera on the ground. Without orbit and site, the imported orbit is used if it covers the frames.
    ``top_rate_deg_s``: maximum angular rate of the objects to search for."""

    kind: Literal["moving"]
    profile: str = Field(max_length=40)
    frame_ids: Annotated[list[Id], Field(min_length=1, max_length=MAX_FRAMES)]
    chain: str = Field(default="reference", max_length=30)
    objects: str = Field(default="", max_length=MAX_CHARACTERS)
    orbit: str = Field(default="", max_length=MAX_CHARACTERS)
    site: Annotated[list[float], Field(min_length=3, max_length=3)] | None = None
    top_rate_deg_s: float = Field(default=2.0, gt=0, le=20)
    title: str = Field(default="", max_length=120)

    @property
    def top_rate_rad_s(self) -> float:
        """Maximum angular rate of the objects to search for, in radians per second."""
        return math.radians(self.top_rate_deg_s)

    @property
    def place(self) -> CameraPlace | None:
        """Position of the camera; None if neither orbit nor site is given."""
        return place_of(self.orbit, None if self.site is None else (self.site[0], self.site[1], self.site[2]))

    @model_validator(mode="after")
    def _possible(self) -> Self:
        check_chain(self.chain)
        check_different(self.frame_ids)
        _ = self.place
        read_objects(self.objects)
        return self


class HealthRequest(Request):
    """Health of a sensor from ordinary frames of a mission. ``orbit``: TLE, OMM or OEM of the spacecraft, or the
    element sets of the complete mission. If it is missing, the imported orbits are used if they cover the frames."""

    kind: Literal["health"]
    profile: str = Field(max_length=40)
    frame_ids: Annotated[list[Id], Field(min_length=1, max_length=MAX_FRAMES)]
    chain: str = Field(default="reference", max_length=30)
    orbit: str = Field(default="", max_length=MAX_CHARACTERS)
    title: str = Field(default="", max_length=120)

    @property
    def trajectories(self) -> list[Trajectory]:
        """Orbits of the spacecraft; empty if none is given."""
        return read_orbits(self.orbit) if self.orbit else []

    @model_validator(mode="after")
    def _possible(self) -> Self:
        check_chain(self.chain)
        check_different(self.frame_ids)
        _ = self.trajectories
        return self


AnalysisRequest = Annotated[
    FrameAnalysis | TelemetryAnalysis | SheetRequest | MovingRequest | HealthRequest, Field(discriminator="kind")
]


@dataclass(frozen=True)
class AnalysisJob(JobRequest):
    """Job request of an analysis."""

    wanted: AnalysisRequest


def earlier_request(stored: JsonObject) -> JsonObject:
    """Convert a request stored by version 0.4, which contains radians and stores the title separately."""
    if "title" not in stored:
        return stored
    request = dict(stored["wanted"])
    if "contact_id" in request:
        request = {"kind": "telemetry", "contact": request["contact_id"]}
    else:
        rate = request.pop("commanded_rad_s", None)
        request["commanded_deg_s"] = None if rate is None else math.degrees(rate)
    return {"wanted": request | {"title": stored["title"]}, "user": stored.get("user", "")}
