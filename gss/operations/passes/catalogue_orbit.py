"""Comparison of a stored catalogue with the imported orbit: whether its envelope contains the orbit, and until when."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Literal

from pydantic import ValidationError

from gss.catalogue_tools.envelope.attitude import ORBIT_LAWS
from gss.catalogue_tools.envelope.orbit_fit import orbit_fit
from gss.catalogue_tools.plan import planes_of
from gss.domain.errors import BadInput
from gss.operations.catalogues.catalogue_request import CatalogueRequest, orbit_of
from gss.operations.passes.spacecraft import CurrentOrbit
from gss.store.models import Catalogue

CatalogueOrbitState = Literal["independent", "unknown", "inside", "leaving", "outside"]


@dataclass(frozen=True)
class CatalogueOrbit:
    """``state``: independent (the catalogue does not depend on the orbit), unknown, inside, leaving (within the warning time)
    or outside; ``leaves``: time at which the orbit leaves the envelope; ``text``: sentence for users."""

    state: CatalogueOrbitState
    leaves: datetime | None
    text: str


def catalogue_orbit(
    catalogue: Catalogue, current: CurrentOrbit | None, now: datetime, warning: timedelta
) -> CatalogueOrbit:
    """Compare a catalogue with the active orbit. ``warning``: time before leaving at which the state becomes leaving."""
    if not catalogue.validity_known:
        return _unknown("it was read back from the unit, so its build request is not known")
    try:
        request = CatalogueRequest.model_validate(catalogue.request)
    except ValidationError:
        return _unknown("its build request cannot be read")
    if request.orbit == "none" or request.pointing not in ORBIT_LAWS:
        return CatalogueOrbit("independent", None, "The catalogue does not depend on the orbit.")
    if current is None:
        return _unknown("no orbit was imported")
    if current.row.kind != "tle":
        return _unknown("the imported orbit is an ephemeris without elements")
    try:
        planes = planes_of(orbit_of(request), catalogue.valid_from, request.days)
        if planes is None:
            return _unknown("its orbital planes are not stored")
        fit = orbit_fit(planes, math.radians(request.margin_deg), current.row.text, now)
    except BadInput as error:
        return _unknown(str(error))
    name = f"The orbit of {current.row.spacecraft}"
    if not fit.inside:
        angle = math.degrees(fit.outside_rad)
        return CatalogueOrbit(
            "outside", None, f"{name} is {angle:.1f}° outside the envelope. Build a catalogue for this orbit."
        )
    if fit.leaves is None:
        return CatalogueOrbit("inside", None, f"{name} stays in the envelope for a year.")
    text = f"{name} leaves the envelope on {fit.leaves:%Y-%m-%d}."
    if fit.leaves - now < warning:
        return CatalogueOrbit("leaving", fit.leaves, f"{text} Build and upload a new catalogue before.")
    return CatalogueOrbit("inside", fit.leaves, text)


def _unknown(reason: str) -> CatalogueOrbit:
    return CatalogueOrbit("unknown", None, f"Not compared with the orbit: {reason}.")
