"""Factory programming of a unit: golden catalogue, calibration, parameters, triplets and an empty bad-pixel table."""

from __future__ import annotations

from gss.catalogue_tools.formats.triplet_table import HEADER_VERSION, encode_triplets
from gss.catalogue_tools.onboard import FORMATS, decode, read_header
from gss.device.simulator.flash_record import area_name
from gss.device.simulator.memory import FACTORY, GOLDEN, BankRecord, Memory
from gss.device.table_use import calibration_values, chain_of, parameter_values
from gss.device.tables import BAD_PIXELS, NO_PIXELS, TABLE_FORMAT, encode_bad_pixels, encode_table
from gss.domain.camera_profile import CameraProfile
from gss.instruments.golden import Golden


def burn_golden(memory: Memory, profile: CameraProfile, golden: Golden) -> None:
    """Program the factory catalogue into the golden bank and its tables into the factory banks."""
    header = read_header(golden.image)
    record = BankRecord(
        stars=header.stars,
        pairs=header.pairs,
        epoch_jyear=header.epoch_jyear,
        format_version=FORMATS[header.format_name],
        profile=profile.name,
    )
    memory.burn(GOLDEN, golden.image, record)
    tables = {
        "calibration": encode_table("calibration", profile.name, calibration_values(profile)),
        "parameters": encode_table("parameters", profile.name, parameter_values(profile)),
        BAD_PIXELS: encode_bad_pixels(profile.name, NO_PIXELS),
    }
    for kind, content in tables.items():
        table = BankRecord(format_version=TABLE_FORMAT, profile=profile.name)
        memory.burn(area_name(kind, FACTORY), content, table)
    # Only Oersted's chain uses triplets; for other chains the factory bank of triplets is empty. The golden bank
    # contains the same triplets. They are also stored as a separate table, so the table can be read alone.
    prepared = chain_of(profile).prepare(decode(golden.image), profile)
    if hasattr(prepared, "triplets"):
        image = encode_triplets(prepared.triplets, header.body_crc32)
        table = BankRecord(
            stars=header.stars,
            pairs=len(prepared.triplets),
            format_version=HEADER_VERSION,
            profile=profile.name,
        )
        memory.burn(area_name("triplets", FACTORY), image, table)
