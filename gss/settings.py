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
    blobs: str = Field(
        default="", description="fsspec URL of frames and images of flash; empty: inside the data folder."
    )
    host: str = Field(
        default="127.0.0.1", description="Address to listen on; another than loopback needs TLS or a proxy."
    )
    port: int = Field(default=8181, ge=0, le=65535, description="Port of the console; 0 takes a free one.")
    workers: int = Field(
        default=0,
        ge=0,
        le=16,
        description="API worker processes beside the process that owns the line; 0: one process does everything.",
    )
    device: str = Field(
        default="", description="Port of the sensor to open at start: a tty, socket:// or rfc2217:// URL."
    )
    link_allow: str = Field(
        default="",
        description="Hosts and networks besides this machine on which operators may open a line, with commas between; "
        "admins may open any.",
    )
    framing: Literal["cobs", "slip"] = Field(
        default="cobs", description="How packets are framed on the line: cobs or slip, as the sensor does."
    )
    simulator: str = Field(
        default="", description="Camera profile of a simulated sensor to start and open, for example cubestar."
    )
    simulator_baud: int = Field(default=3_000_000, ge=0, description="Line rate of the simulated sensor; 0 is unpaced.")
    simulator_options: str = Field(
        default="",
        description="Further options of the simulated sensor, as gss simulate takes them, for example --sky real.",
    )
    simulator_seed: int = Field(default=1, description="Seed of the simulated sensor's noise and motion.")
    capture_file_mb: int = Field(
        default=64, ge=1, le=4096, description="Size at which a file of the raw capture is closed and the next begun."
    )
    capture_keep_mb: int = Field(
        default=1024, ge=1, description="The oldest files of the raw capture go when all together are larger."
    )
    tls_certificate: str = Field(default="", description="File of the certificate (PEM, with its chain): serves HTTPS.")
    tls_key: str = Field(default="", description="File of the certificate's private key (PEM).")
    behind_proxy: bool = Field(
        default=False, description="A reverse proxy with TLS stands in front; direct requests of others are refused."
    )
    trusted_proxies: str = Field(
        default="127.0.0.1,::1", description="Addresses or networks of that proxy; only its X-Forwarded-* are believed."
    )
    public_names: str = Field(
        default="", description="Host names under which browsers know this server, with commas between."
    )
    streams_each: int = Field(
        default=20, ge=1, description="Event streams (open pages) of one user or token at a time, in each process."
    )
    streams_most: int = Field(
        default=500, ge=1, description="Event streams of everybody together at a time, in each process."
    )
    connections_most: int = Field(
        default=800,
        ge=8,
        le=900,
        description="Open connections at a time in each process, at most half of the files it may open (1024, or fewer if the "
        "system allows fewer); at most half of them without sign-in.",
    )
    session_idle_minutes: float = Field(
        default=480, gt=0, le=44_640, description="A session ends when nothing was asked for so long."
    )
    session_hours: float = Field(default=24, gt=0, le=744, description="A session ends after so long whatever happens.")
    password_memory_kib: int = Field(
        default=65_536,
        ge=8,
        le=4_194_304,
        description="Memory of one password hash (argon2id); less than 19456 is weak.",
    )
    password_passes: int = Field(default=3, ge=1, le=100, description="Passes of one password hash (argon2id).")
    backups: str = Field(default="", description="Folder of the backups; empty: inside the data folder.")
    disk_watch_mb: int = Field(default=2048, ge=0, description="Free space below which there is an alarm.")
    disk_stop_mb: int = Field(
        default=256, ge=0, description="Free space below which imports, downloads, builds and backups are refused."
    )
    retention_pause_days: float = Field(
        default=30,
        gt=0,
        le=3650,
        description="Retention and rotation of backups pause where the clock is further ahead of the last trusted time.",
    )
    retention_share_percent: float = Field(
        default=20,
        ge=1,
        le=100,
        description="A removal of a larger part of the frames, packets or events waits for a person to confirm it.",
    )
    catalogue_watch_days: float = Field(
        default=5.0, ge=0, le=366, description="Days before the active catalogue expires at which the alarm begins."
    )
    cluster: str = Field(
        default="",
        description="URL of a Dask scheduler for reprocessing and campaigns; empty: processes of this machine.",
    )
    solve_chain: str = Field(
        default="reference",
        description="Chain of the operational ground result: runs on every received or imported frame.",
    )

    @property
    def database_url(self) -> str:
        """Effective database URL."""
        return self.database or f"sqlite:///{(self.data / 'gss.db').resolve()}"

    @property
    def backups_folder(self) -> Path:
        """Effective folder of the backups."""
        return Path(self.backups) if self.backups else self.data / "backups"

    @property
    def blobs_url(self) -> str:
        """Effective URL of the blob store."""
        return self.blobs or str((self.data / "blobs").resolve())
