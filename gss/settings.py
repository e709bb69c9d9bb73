"""All settings, from GSS_* environment variables. Read only by the command line and the wiring."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict


class Settings(BaseSettings):
    """Server settings. The defaults run everything on one machine."""

    model_config = SettingsConfigDict(env_prefix="GSS_", extra="ignore")

    data: Path = Field(
        default=Path("var"), description="Folder of the database, frames, captures and the simulator's flash."
    )
    database: str = Field(default="", description="SQLAlchemy URL; empty: SQLite inside the data folder.")
    accounts: str = Field(
        default="",
        description="SQLAlchemy URL of the database with users, sessions and tokens; empty: the same database.",
    )
    packages: str = Field(
        default="", description="Folder of your own instrument packages; empty: instruments in the data folder."
    )
    blobs: str = Field(default="", description="fsspec URL for frames and flash images; empty: inside the data folder.")
    host: str = Field(
        default="127.0.0.1", description="Address to listen on; an address other than loopback needs TLS or a proxy."
    )
    port: int = Field(default=8181, ge=0, le=65535, description="Port of the console; 0 selects a free port.")
    workers: int = Field(
        default=0,
        ge=0,
        le=16,
        description="API worker processes beside the process that owns the line; 0: one process does everything.",
    )
    device: str = Field(
        default="",
        description="Port of the sensor to open at start: a tty, or a socket://, rfc2217://, udp://, zmq:// or can:// URL.",
    )
    units: str = Field(
        default="",
        description="Several units, separated by commas: NAME=INSTRUMENT@ADDRESS; the address simulator starts a simulated "
        "sensor.",
    )
    auto_download: bool = Field(
        default=True, description="Download each new frame automatically; off: frames are downloaded on request only."
    )
    link_allow: str = Field(
        default="",
        description="Other hosts and networks on which operators may open a line, separated by commas; admins may open "
        "any.",
    )
    framing: Literal["", "cobs", "slip"] = Field(
        default="",
        description="Framing of packets on the line: cobs or slip; empty: as the instrument's package states.",
    )
    link_keys: str = Field(
        default="",
        description="File of the keys that authenticate packets to the sensor, created with gss link-keys; empty: packets are "
        "not signed.",
    )
    simulator: str = Field(
        default="", description="Instrument of a simulated sensor to start and open, for example cubestar."
    )
    instrument: str = Field(
        default="cubestar", description="Instrument of the unit on the line, and of commands that name none."
    )
    simulator_baud: int = Field(default=3_000_000, ge=0, description="Line rate of the simulated sensor; 0 is unpaced.")
    simulator_options: str = Field(
        default="",
        description="Further options of gss simulate for the simulated sensor, for example --sky real.",
    )
    simulator_seed: int = Field(default=1, description="Seed of the simulated sensor's noise and motion.")
    capture_file_mb: int = Field(
        default=64, ge=1, le=4096, description="Size at which a raw capture file is closed and the next one is started."
    )
    capture_keep_mb: int = Field(
        default=1024, ge=1, description="Total size of the raw capture above which the oldest files are deleted."
    )
    tls_certificate: str = Field(default="", description="Certificate file (PEM, with its chain): enables HTTPS.")
    tls_key: str = Field(default="", description="Private key file of the certificate (PEM).")
    behind_proxy: bool = Field(
        default=False,
        description="Run behind a reverse proxy with TLS; direct requests from other addresses are rejected.",
    )
    trusted_proxies: str = Field(
        default="127.0.0.1,::1",
        description="Addresses or networks of that proxy; X-Forwarded-* headers from other addresses are ignored.",
    )
    public_names: str = Field(default="", description="Host names of this server in browsers, separated by commas.")
    streams_each: int = Field(
        default=20, ge=1, description="Event streams (open pages) of one user or token at a time, in each process."
    )
    streams_most: int = Field(
        default=500, ge=1, description="Event streams of all users together at a time, in each process."
    )
    connections_most: int = Field(
        default=800,
        ge=8,
        le=900,
        description="Open connections at a time in each process, at most half of the permitted open files (1024, or the "
        "system's limit if lower); at most half of them without sign-in.",
    )
    session_idle_minutes: float = Field(
        default=480, gt=0, le=44_640, description="A session ends after this time without a request."
    )
    session_hours: float = Field(default=24, gt=0, le=744, description="A session ends after this time in any case.")
    password_memory_kib: int = Field(
        default=65_536,
        ge=8,
        le=4_194_304,
        description="Memory of one password hash (argon2id); values below 19456 are weak.",
    )
    password_passes: int = Field(default=3, ge=1, le=100, description="Passes of one password hash (argon2id).")
    audit_anchor: str = Field(
        default="",
        description="File to which the hash of every row of the audit log is appended; empty: inside the data folder.",
    )
    backups: str = Field(default="", description="Folder of the backups; empty: inside the data folder.")
    disk_watch_mb: int = Field(default=2048, ge=0, description="Free space below which an alarm is raised.")
    disk_stop_mb: int = Field(
        default=256, ge=0, description="Free space below which imports, downloads, builds and backups are rejected."
    )
    retention_pause_days: float = Field(
        default=30,
        gt=0,
        le=3650,
        description="Retention and rotation of backups pause if the clock is further ahead of the last trusted time.",
    )
    retention_share_percent: float = Field(
        default=20,
        ge=1,
        le=100,
        description="A removal of a larger share of the frames, packets or events needs confirmation.",
    )
    catalogue_watch_days: float = Field(
        default=5.0,
        ge=0,
        le=366,
        description="Days before expiry of the active catalogue at which the alarm is raised.",
    )
    cluster: str = Field(
        default="",
        description="URL of a Dask scheduler for reprocessing and campaigns; empty: processes of this machine.",
    )
    solve_chain: str = Field(
        default="reference",
        description="Chain of the operational ground result: runs on every received or imported frame.",
    )

    notifications: str = Field(
        default="", description="File of notification targets and rules; empty: no notifications are sent."
    )
    notifications_private: bool = Field(
        default=False, description="Permit notification targets on loopback and private addresses."
    )

    @property
    def unit_instrument(self) -> str:
        """Name of the instrument on the line. If a unit is simulated, this is the instrument of the simulated unit."""
        return self.simulator or self.instrument

    @property
    def instruments_folder(self) -> Path:
        """Folder of the user's own instrument packages."""
        return Path(self.packages) if self.packages else self.data / "instruments"

    @property
    def database_url(self) -> str:
        """Effective database URL."""
        return self.database or f"sqlite:///{(self.data / 'gss.db').resolve()}"

    @property
    def audit_anchor_file(self) -> Path:
        """Effective file of the audit log's anchors."""
        return Path(self.audit_anchor) if self.audit_anchor else self.data / "audit-anchor.jsonl"

    @property
    def backups_folder(self) -> Path:
        """Effective folder of the backups."""
        return Path(self.backups) if self.backups else self.data / "backups"

    @property
    def blobs_url(self) -> str:
        """Effective URL of the blob store."""
        return self.blobs or str((self.data / "blobs").resolve())
