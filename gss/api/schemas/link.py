"""Link and device state for the header bar."""

from __future__ import annotations

from typing import Literal

from gss.api.schemas.base import In, Out, Utc

Level = Literal["ok", "watch", "warning", "critical", "unknown"]


class DirectionOut(Out):
    """State of one direction of the line."""

    state: Literal["up", "noisy", "down"]
    age_s: float | None
    error_rate: float
    bytes: int
    frames: int
    bad: int


class DirectionCountersOut(Out):
    """Counters of one direction. For sent data the ground counts only ``bytes`` and ``good``. ``device_good`` and
    ``device_bad`` are the device's counts of received frames, from its latest housekeeping."""

    bytes: int
    good: int
    bad_crc: int
    too_long: int
    too_short: int
    unframed: int
    unknown: int
    undecodable: int
    gaps: int
    duplicates: int
    repeated_ids: int
    device_good: int | None = None
    device_bad: int | None = None


class CountersOut(Out):
    """Counters of the line since the start of the contact, and the active framing."""

    framing: str
    sent: DirectionCountersOut
    received: DirectionCountersOut


class BankOut(Out):
    """Flash bank as reported by the device, with the stored catalogue that it contains, if known. ``validity_known``: false
    if this catalogue is not stored or was read back from the device."""

    bank: str
    state: str
    active: bool
    catalogue_id: int | None
    catalogue_name: str | None
    stars: int | None
    pairs: int | None
    sha256: str | None
    valid_to: Utc | None
    days_left: float | None
    validity_known: bool


class AlarmOut(Out):
    """Value outside its limits, or a link state that needs attention."""

    id: str
    level: Level
    text: str
    since: Utc


class ReportedAttitudeOut(Out):
    """Boresight of the last solved attitude of the sensor, ``age_s``: time since its reception. ``newest_outcome``:
    outcome of the latest report, which can be a later report without a solution."""

    ra_deg: float
    dec_deg: float
    sigma_cross_arcsec: float | None
    age_s: float
    newest_outcome: str


class AttitudeSampleOut(Out):
    """Latest attitude from one source with its time. ``quaternion``: cam_from_icrs, scalar-last; standard deviations
    are null if unknown; ``utc_sigma_s``: uncertainty of ``utc``."""

    source: Literal["on board", "ground"]
    quaternion: tuple[float, float, float, float]
    sigma_cross_arcsec: float | None
    sigma_roll_arcsec: float | None
    utc: Utc
    utc_sigma_s: float


class NextPassOut(Out):
    """Next pass of the spacecraft, or the current pass. ``problem``: why no pass is known, "" otherwise; with a problem
    all other fields are null."""

    station: str | None
    rise: Utc | None
    set: Utc | None
    max_elevation_deg: float | None
    problem: str


class LinkOut(Out):
    """Contents of the header bar. ``attitudes``: latest attitudes on board and on the ground. ``simulated``: null if
    this is not known, because no device has answered or its protocol does not report it. ``tried_on_hardware``: true if
    the instrument package was tested with hardware; null: not stated. ``no_abort``: explanation if the sensor has no
    abort command, otherwise "". ``server_started``: start of the server process that receives telemetry."""

    device: str
    profile: str
    firmware: str
    simulated: bool | None
    tried_on_hardware: bool | None
    no_abort: str
    url: str
    connected: bool
    reason: str
    tx: DirectionOut
    rx: DirectionOut
    mode: str | None
    cycle_running: bool | None
    attitude: ReportedAttitudeOut | None
    attitudes: list[AttitudeSampleOut]
    next_pass: NextPassOut
    active_bank: BankOut | None
    banks: list[BankOut]
    dictionary_hash: str
    device_dictionary_hash: str | None
    dictionary_match: bool | None
    dictionary_acknowledged: bool
    alarms: list[AlarmOut]
    contact_id: int | None
    authority: str | None
    server_started: Utc
    utc: Utc


class LinkOpenIn(In):
    """Address of the device: a tty, a pseudo-terminal, or a socket://, rfc2217://, udp://, zmq:// or can:// address."""

    url: str
