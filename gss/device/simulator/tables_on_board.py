"""Active tables: read from flash and converted to chain, camera, constants, triplets and bad pixels."""

from __future__ import annotations

from typing import Any

from gss.catalogue_tools.formats.triplet_table import bank_crc32_of, decode_triplets
from gss.device.simulator.flash_record import area_name
from gss.device.simulator.memory import FACTORY, TABLES, Memory
from gss.device.table_use import calibrated, chain_of, check_bad_pixels, check_parameters
from gss.device.tables import BAD_PIXELS, NO_PIXELS, Scalar, decode_bad_pixels, decode_table
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput, CorruptData
from gss.pipeline.chains.oersted_match import prepare as prepare_with_triplets
from gss.pipeline.chains.onboard import OnboardChain
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.triplets import TripletTable


class Tables:
    """Content of the active tables. If a table cannot be read, the unit's defaults apply and the problem is
    reported."""

    def __init__(self, profile: CameraProfile, memory: Memory) -> None:
        self._default_profile, self._memory = profile, memory
        self.profile = profile
        self.parameters: dict[str, Scalar] = {}
        self.triplets: TripletTable | None = None
        self.bad_pixels = NO_PIXELS
        self.chain: OnboardChain = chain_of(profile)

    @property
    def key(self) -> tuple[str, ...]:
        """Key of the active tables; it changes when another table becomes active."""
        record = self._memory.record
        areas = [area_name(t, record.tables[t].active) for t in TABLES]
        return tuple(f"{area} {record.banks[area].sha256}" for area in areas)

    def load(self) -> list[str]:
        """Read all tables again. Returns the problems."""
        self.profile, self.parameters, self.triplets = self._default_profile, {}, None
        self.bad_pixels = NO_PIXELS
        problems = []
        for table in TABLES:
            bank = self._memory.record.tables[table].active
            area = area_name(table, bank)
            if self._memory.record.banks[area].state == "empty" and bank == FACTORY:
                continue
            try:
                self._take(table, self._memory.content(area))
            except (BadInput, CorruptData) as error:
                problems.append(f"{table} {bank}: {error}")
        self.chain = chain_of(self._default_profile, self.parameters)
        return problems

    def _take(self, table: str, content: bytes) -> None:
        if table == "calibration":
            self.profile = calibrated(self._default_profile, decode_table(table, content)[1])
        elif table == "parameters":
            values = decode_table(table, content)[1]
            check_parameters(self.profile, values)
            self.parameters = values
        elif table == BAD_PIXELS:
            pixels = decode_bad_pixels(content)[1]
            check_bad_pixels(self._default_profile, pixels)
            self.bad_pixels = pixels
        else:
            self.triplets = decode_triplets(content)

    def prepare(self, catalogue: OnboardCatalogue) -> Any:
        """Return the chain's prepared catalogue, with the active triplet table if the chain uses triplets.

        The factory triplet table belongs to the golden catalogue. It is not used if the bank contains triplets or holds
        another catalogue; the chain then uses the bank's triplets or computes them.
        """
        prepared = self.chain.prepare(catalogue, self.profile)
        used = self._memory.record.tables["triplets"].active
        if self.triplets is None or not hasattr(prepared, "triplets"):
            return prepared
        if used == FACTORY and (catalogue.tables.constellations is not None or not self._belongs()):
            return prepared
        return prepare_with_triplets(catalogue, self.profile, self.triplets)

    def _belongs(self) -> bool:
        """True if the active triplet table belongs to the active bank."""
        record = self._memory.record
        table = self._memory.content(area_name("triplets", record.tables["triplets"].active))
        body_crc = int.from_bytes(self._memory.content(record.active)[56:60], "little")
        return bank_crc32_of(table) in (0, body_crc)
