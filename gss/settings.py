"""All settings, read from GSS_* environment variables. Only the command line and the wiring use this module."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict


class Settings(BaseSettings):
    """Server settings. The defaults run everything on one machine."""

    model_config = SettingsConfigDict(env_prefix="GSS_", extra="ignore")

    data: Path = Field(
        default=Path("var"), description="Data folder: database, frames, captures and the simulator's flash."
    )
    database: str = Field(default="", description="SQLAlchemy URL of the database; empty: SQLite in the data folder.")
    accounts: str = Field(
        default="",
        description="SQLAlchemy URL of the database for users, sessions and tokens; empty: GSS_DATABASE.",
    )
    packages: str = Field(
        default="",
        description="Folder of your own instrument packages; empty: the folder instruments in the data folder.",
    )
    blobs: str = Field(
        default="",
        description="fsspec URL of the store for frames and flash images; empty: the folder blobs in the data folder.",
    )
    host: str = Field(
        default="127.0.0.1", description="Address to listen on; an address other than loopback needs TLS or a proxy."
    )
    port: int = Field(default=8181, ge=0, le=65535, description="Port of the console; 0 selects a free port.")
    workers: int = Field(
        default=0,
        ge=0,
        le=16,
        description="Number of API worker processes in addition to the process that owns the line; 0: a single "
        "process.",
    )
    device: str = Field(
        default="",
        description="Port of the sensor to open at start: a tty, or a socket://, rfc2217://, udp://, zmq:// or "
        "can:// URL.",
    )
    units: str = Field(
        default="",
        description="Several units, separated by commas, each as NAME=INSTRUMENT@ADDRESS; with the address "
        "simulator, a "
        "simulated sensor is started.",
    )
    auto_download: bool = Field(
        default=True, description="Download each new frame automatically; false: only on request."
    )
    link_allow: str = Field(
        default="",
        description="Additional hosts and networks to which operators can open a line, separated by commas; admins can "
        "open a line to any host.",
    )
    framing: Literal["", "cobs", "slip"] = Field(
        default="",
        description="Framing of packets on the line: cobs or slip; empty: the framing in the instrument package.",
    )
    link_keys: str = Field(
        default="",
        description="File of the keys that authenticate packets to the sensor, created with gss link-keys; "
        "empty: packets are "
        "not signed.",
    )
    simulator: str = Field(
        default="", description="Instrument of a simulated sensor to start and open, for example cubestar."
    )
    instrument: str = Field(
        default="cubestar",
        description="Instrument of the unit on the line; also the default instrument of the command line.",
    )
    simulator_baud: int = Field(
        default=3_000_000, ge=0, description="Line rate of the simulated sensor in baud; 0: no limit."
    )
    simulator_options: str = Field(
        default="",
        description="Additional gss simulate options for the simulated sensor, for example --sky real.",
    )
    simulator_seed: int = Field(default=1, description="Seed of the simulated sensor's noise and motion.")
    capture_file_mb: int = Field(
        default=64,
        ge=1,
        le=4096,
        description="Size in MB at which a raw capture file is closed and a new file is started.",
    )
    capture_keep_mb: int = Field(
        default=1024, ge=1, description="Total size in MB of the raw capture files above which the oldest are deleted."
    )
    tls_certificate: str = Field(default="", description="Certificate file (PEM, with its chain): enables HTTPS.")
    tls_key: str = Field(default="", description="Private key file of the certificate (PEM).")
    behind_proxy: bool = Field(
        default=False,
        description="Run behind a reverse proxy with TLS; direct requests from other addresses are rejected.",
    )
    trusted_proxies: str = Field(
        default="127.0.0.1,::1",
        description="Addresses or networks of the reverse proxy; X-Forwarded-* headers from other addresses are "
        "ignored.",
    )
    public_names: str = Field(default="", description="Host names of this server in browsers, separated by commas.")
    streams_each: int = Field(
        default=20,
        ge=1,
        description="Maximum number of concurrent event streams (open pages) per user or token in each process.",
    )
    streams_most: int = Field(
        default=500, ge=1, description="Maximum number of concurrent event streams of all users in each process."
    )
    connections_most: int = Field(
        default=800,
        ge=8,
        le=900,
        description="Maximum number of concurrent connections in each process, reduced to half of the open-file "
        "limit if "
        "that is lower. At most half of them can be unauthenticated.",
    )
    session_idle_minutes: float = Field(
        default=480, gt=0, le=44_640, description="A session ends after this time in minutes without a request."
    )
    session_hours: float = Field(
        default=24, gt=0, le=744, description="A session ends this number of hours after sign-in, even if it is active."
    )
    password_memory_kib: int = Field(
        default=65_536,
        ge=8,
        le=4_194_304,
        description="Memory in KiB for one password hash (argon2id); values below 19456 are weak.",
    )
    password_passes: int = Field(
        default=3, ge=1, le=100, description="Number of argon2id passes for one password hash."
    )
    audit_anchor: str = Field(
        default="",
        description="File to which the hash of every row of the audit log is appended; empty: audit-anchor.jsonl "
        "in the data folder.",
    )
    backups: str = Field(default="", description="Folder of the backups; empty: the folder backups in the data folder.")
    disk_watch_mb: int = Field(default=2048, ge=0, description="Free space in MB below which an alarm is raised.")
    disk_stop_mb: int = Field(
        default=256,
        ge=0,
        description="Free space in MB below which imports, downloads and builds are rejected, and backups if it is the disk of "
        "their folder.",
    )
    retention_pause_days: float = Field(
        default=30,
        gt=0,
        le=3650,
        description="Retention and backup rotation pause if the clock is more than this number of days ahead of "
        "the last trusted time.",
    )
    retention_share_percent: float = Field(
        default=20,
        ge=1,
        le=100,
        description="Deleting more than this percentage of the frames, packets or events needs confirmation.",
    )
    catalogue_watch_days: float = Field(
        default=5.0,
        ge=0,
        le=366,
        description="Number of days before the active catalogue expires at which an alarm is raised.",
    )
    cluster: str = Field(
        default="",
        description="URL of a Dask scheduler for reprocessing and campaigns; empty: processes on this machine.",
    )
    solve_chain: str = Field(
        default="reference",
        description="Chain of the operational ground result; it runs on every received or imported frame.",
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
