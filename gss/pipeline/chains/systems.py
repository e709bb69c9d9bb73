"""Registry of the chains by name. A new chain is registered by one line here."""

from __future__ import annotations

from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import NotFound
from gss.pipeline.chains import (
    aim_parameters,
    cubestar_parameters,
    far_mst_parameters,
    oersted_parameters,
    sunsat_parameters,
)
from gss.pipeline.chains.aim import AimChain
from gss.pipeline.chains.cubestar_onboard import CubestarChain
from gss.pipeline.chains.far_mst_onboard import FarMstChain
from gss.pipeline.chains.oersted import OerstedChain
from gss.pipeline.chains.onboard import OnboardChain
from gss.pipeline.chains.sunsat_onboard import SunsatChain

SYSTEMS: dict[str, OnboardChain] = {
    c.name: c for c in (CubestarChain(), FarMstChain(), SunsatChain(), OerstedChain(), AimChain())
}

CONSTANT_SOURCES: dict[str, dict[str, str]] = {
    m.NAME: m.SOURCES
    for m in (sunsat_parameters, cubestar_parameters, far_mst_parameters, oersted_parameters, aim_parameters)
}
"""Document section or reason of each constant of each chain."""


def system(name: str) -> OnboardChain:
    """Return the chain with that name."""
    try:
        return SYSTEMS[name]
    except KeyError:
        raise NotFound("unknown chain of a sensor", expected=" | ".join(SYSTEMS), got=name) from None


def on_board(profile: CameraProfile) -> OnboardChain:
    """Return the chain of a unit with this camera profile. Raises NotFound if it has none."""
    return system(profile.chain)
