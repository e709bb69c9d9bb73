"""What happens to a unit before it leaves the factory: the golden catalogue is burnt."""

from __future__ import annotations

from gss.catalogue_tools.onboard import FORMATS, read_header
from gss.device.golden import Golden
from gss.device.simulator.memory import GOLDEN, BankRecord, Memory
from gss.domain.profiles import CameraProfile


def burn_golden(memory: Memory, profile: CameraProfile, golden: Golden) -> None:
    """Put the factory catalogue into the golden bank and make it the active one."""
    header = read_header(golden.image)
    record = BankRecord(
        stars=header.stars,
        pairs=header.pairs,
        epoch_jyear=header.epoch_jyear,
        format_version=FORMATS[header.format_name],
        profile=profile.name,
    )
    memory.burn(GOLDEN, golden.image, record)
