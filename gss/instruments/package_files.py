"""Models of further files of a package: ``instrument.yaml``, ``link.yaml``, ``catalogue.yaml``, ``simulator.yaml``."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from gss.catalogue_tools.envelope.attitude import ORBIT_LAWS
from gss.catalogue_tools.formats.registry import BY_NAME
from gss.domain.sensor import Defects
from gss.instruments.link_file import LinkFile
from gss.instruments.quantities import Noted, Sourced, Strict, Text
from gss.pipeline.chains.systems import SYSTEMS

__all__ = ["CatalogueFile", "InstrumentFile", "LinkFile", "Mounting", "SimulatorFile"]

DRIVERS = "gss.drivers"
"""Entry point group of the drivers."""

NAME_PATTERN = r"^[a-z][a-z0-9_-]{1,15}$"
"""Pattern of names. They fit in the 16 bytes of the HELLO report and of a bank's header."""


def _one_of(names: tuple[str, ...]) -> AfterValidator:
    def check(name: str) -> str:
        if name not in names:
            raise ValueError(f"must be one of {', '.join(names)}")
        return name

    return AfterValidator(check)


def _installed(name: str) -> str:
    names = sorted(entry_points(group=DRIVERS).names)
    if name not in names:
        raise ValueError(f"no such driver is installed; must be one of {', '.join(names)}")
    return name


Name = Annotated[str, Field(pattern=NAME_PATTERN)]
DriverName = Annotated[str, AfterValidator(_installed)]
Chain = Annotated[str, _one_of(tuple(SYSTEMS))]
Format = Annotated[str, _one_of(tuple(BY_NAME))]
Law = Annotated[str, _one_of(tuple(ORBIT_LAWS))]
Positive = Annotated[float, Field(gt=0, le=1e12)]
NotNegative = Annotated[float, Field(ge=0, le=1e12)]
Fraction = Annotated[float, Field(ge=0, le=1)]
AngleDeg = Annotated[float, Field(ge=-360, le=360)]
ChecklistItem = Annotated[str, Field(min_length=1, max_length=200)]


class Mounting(Strict):
    """Mounting of the camera in the satellite: name of the mounting, and nominal roll, pitch and yaw."""

    camera: Law
    at_rest_deg: tuple[AngleDeg, AngleDeg, AngleDeg] = (0.0, 0.0, 0.0)


class InstrumentFile(Strict):
    """``instrument.yaml``. ``version``: package version that its author assigns. ``dictionary``: name of a shared
    dictionary; absent if the package contains a dictionary. ``driver``: name of an installed driver. ``chain``: absent
    if the chain of the unit is unknown. ``notes``: information for the operator. ``tried_on_hardware``: False if the
    package is based only on documents; None: not stated. ``checklist``: items that an operator checks in each contact.
    """

    id: Name
    title: Text
    maker: Annotated[str, Field(max_length=200)] = ""
    version: Annotated[str, Field(min_length=1, max_length=40)]
    references: tuple[Text, ...] = ()
    driver: DriverName
    chain: Chain | None = None
    dictionary: Annotated[str, Field(max_length=40)] | None = None
    tried_on_hardware: bool | None = None
    mounting: Mounting
    notes: Annotated[str, Field(max_length=4000)] = ""
    checklist: Annotated[tuple[ChecklistItem, ...], Field(max_length=40)] = ()


class BankFormatRow(Strict):
    """One on-board format. ``matching``: True if the format contains all data that the unit's matching needs."""

    name: Format
    matching: bool = True


class CatalogueFile(Noted):
    """``catalogue.yaml``: on-board formats (the native format first), banks with the capacity of each in bytes, and
    tables."""

    formats: Annotated[tuple[BankFormatRow, ...], Field(min_length=1, max_length=20)]
    banks: Annotated[tuple[Annotated[str, Field(max_length=16)], ...], Field(min_length=1, max_length=16)]
    bank_bytes: Annotated[int, Field(ge=4096, le=1 << 26)]
    tables: tuple[Annotated[str, Field(max_length=16)], ...] = ()

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        for name in ("formats", "banks", "tables"):
            rows = [str(row) for row in getattr(self, name)]
            if len(set(rows)) < len(rows):
                raise ValueError(f"{name}: an entry appears twice")
        if not self.formats[0].matching:
            raise ValueError("formats: the first one is the unit's native format and must be sufficient for matching")
        return self


class DefectsRow(Sourced):
    """Defects of the simulated detector and lens; see :class:`gss.domain.sensor.Defects`."""

    response_sigma: Fraction = 0.0
    offset_sigma_dn: NotNegative = 0.0
    column_sigma_dn: NotNegative = 0.0
    dark_sigma: NotNegative = 0.0
    hot_share: Fraction = 0.0
    hot_e_s: NotNegative = 0.0
    dead_share: Fraction = 0.0
    corner_loss: Fraction = 0.0
    corner_blur_px: Annotated[float, Field(ge=0, le=20)] = 0.0
    row_skew_ms: Annotated[float, Field(ge=0, le=2000)] = 0.0
    coupling_px: NotNegative = 0.0

    def defects(self) -> Defects:
        """Return the values without their source."""
        return Defects(**self.model_dump(exclude={"source", "chosen"}))


class UnitTiming(Noted):
    """Times and speeds of the simulated unit. Defaults: a CMOS imager with an FPGA (Erlank 2013 §5.3.3, §5.3.6); values
    that are not in the document are chosen.

    ``frame_ms``: frame periods of a rolling-shutter imager. The shortest period that contains the exposure is used. The
    rows then end their exposure one after another during the readout. If the list is empty, the exposure time does not
    depend on a frame period. ``readout_overlaps``: True if an image is read out while the next one is exposed.
    ``copy_bytes_ms`` 0: no copy, because the readout writes to the processor's memory. ``cycle_ms``: period of the
    cycle at power-on.
    """

    boot_s: NotNegative = 0.3
    housekeeping_s: Positive = 1.0
    cycle_ms: Annotated[int, Field(ge=500, le=60_000)] = 1000
    sensor_start_ms: NotNegative = 70.0
    frame_ms: tuple[Positive, ...] = ()
    readout_bytes_ms: Positive = 10_000.0
    readout_overlaps: bool = False
    copy_bytes_ms: NotNegative = 1_048.576
    erase_bank_s: NotNegative = 0.4
    erase_table_s: NotNegative = 0.1
    flash_read_bytes_s: Positive = 400_000.0


TYPICAL = UnitTiming()


class Currents(Strict):
    """Supply currents of one rail in tenths of a milliampere: idle, sensor starting, busy, copying an image to the
    processor, and latched up. ``starting`` and ``copying`` default to the idle current."""

    idle: NotNegative
    busy: NotNegative
    latched: NotNegative
    starting: NotNegative | None = None
    copying: NotNegative | None = None


class PowerRow(Noted):
    """Power of the simulated unit; the defaults describe a small CMOS camera (chosen). ``trip_s``: time from a
    latch-up to the reaction of the protection. ``off``: current of a rail that is off, in tenths of a milliampere.
    ``processor``: this rail cannot be switched and cannot latch up."""

    trip_s: NotNegative = 1.5
    off: NotNegative = 2
    processor: Currents = Currents(idle=285, busy=415, latched=415)
    imager: Currents = Currents(idle=20, busy=540, latched=2400)
    fpga: Currents = Currents(idle=30, busy=210, latched=1400)
    sram: Currents = Currents(idle=40, busy=100, latched=1100)


class SimulatorFile(Strict):
    """``simulator.yaml``: properties of the simulated unit. ``program``: entry point in the group ``gss.simulators``
    for a third-party unit; by default the shared simulator. ``motion``: default motion of a simulation; "inertial" for
    a camera whose long exposure needs a satellite at rest. ``star_colours``: True if the brightness of a rendered star
    depends on its colour index and the spectral response of the camera (Liebe 1992); otherwise stars have their V."""

    program: Annotated[str, Field(max_length=40)] = ""
    motion: Literal["zenith", "inertial"] = "zenith"
    star_colours: bool = False
    defects: DefectsRow | None = None
    timing: UnitTiming = UnitTiming()
    power: PowerRow = PowerRow()
