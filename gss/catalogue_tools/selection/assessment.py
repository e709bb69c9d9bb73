"""What is to be known of a catalogue before it goes on board: fields, mistakes, lifetime, the map, planets in the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gss.catalogue_tools.corrections.exclusions import exclusions, within
from gss.catalogue_tools.envelope.envelope import Envelope
from gss.catalogue_tools.envelope.healpix import centres
from gss.catalogue_tools.envelope.lifetime import Lifetime
from gss.catalogue_tools.envelope.occultation import OccultedEnvelope
from gss.catalogue_tools.plan import Plan
from gss.catalogue_tools.selection.ambiguity import AmbiguityMap, ambiguity_map
from gss.catalogue_tools.selection.quality import Quality, assess
from gss.domain.angles import Array, ra_dec_from_unit
from gss.domain.stars import DistanceTable, StarTable

MAP_NSIDE = 32
AMBIGUITY_NSIDE = 16
# Fainter than this a planet is one star among many.
PLANET_MAG = 6.0
SUN = "Sun"
WAY_POINTS = 60


@dataclass(frozen=True)
class EnvelopeMap:
    """``fraction``: (12·nside²,) share of time in the field by HEALPix ring pixel. Edges: lines of (k, 3) ICRS directions."""

    nside: int
    fraction: Array
    edges_start: tuple[Array, ...]
    edges_end: tuple[Array, ...]


@dataclass(frozen=True)
class Wanderer:
    """The Sun, or a body that the envelope shows at some time: ``track`` (k, 3) ICRS from first to last day, its brightest, and
    the share of the days on which it is in the envelope."""

    name: str
    track: Array
    brightest_mag: float
    share: float


@dataclass(frozen=True)
class Assessment:
    """``ambiguity`` None for fewer than three stars. ``blinded``: shares of time by what hides the sky, {} for nothing."""

    quality: Quality
    map: EnvelopeMap
    ambiguity: AmbiguityMap | None
    lifetime: Lifetime
    blinded: dict[str, float]
    wanderers: tuple[Wanderer, ...]

    def facts(self) -> dict[str, Any]:
        """Plain values for the manifest."""
        return {
            "lifetime_days": _finite(self.lifetime.days),
            "lifetime_until": self.lifetime.until.isoformat() if self.lifetime.until else None,
            "lifetime_threshold": self.lifetime.threshold,
            "ambiguity": None if self.ambiguity is None else plain(self.ambiguity.facts()),
            "blinded": self.blinded,
            "wanderers": [{"name": w.name, "brightest_mag": w.brightest_mag, "share": w.share} for w in self.wanderers],
        }


def assess_catalogue(
    p: Plan, kept: StarTable, distances: DistanceTable, directory: StarTable | None = None
) -> Assessment:
    """Judge the stars on ICRS axes and their distances over everything that the plan's envelope shows. ``directory``: those of
    them that the device searches, which is where they can be mistaken; None: all."""
    rng = np.random.default_rng(p.request.seed)
    quality = assess(kept.icrs, p.envelope, p.shape, p.request.pointings, rng, distances, _tolerance_rad(p))
    mistakes = ambiguity(p, p.envelope, kept if directory is None else directory, AMBIGUITY_NSIDE)
    return Assessment(quality, envelope_map(p.envelope), mistakes, p.lifetime(), _blinded(p), wanderers(p))


def ambiguity(p: Plan, envelope: Envelope, kept: StarTable, nside: int) -> AmbiguityMap | None:
    """Where the kept stars look like others; None for fewer than three."""
    if len(kept) < 3:
        return None
    radius, longest = p.shape.equal_circle_rad, p.pair_max_rad
    return ambiguity_map(kept.icrs, envelope, radius, _tolerance_rad(p), longest, nside=nside)


def envelope_map(envelope: Envelope, nside: int = MAP_NSIDE) -> EnvelopeMap:
    """Share of time and edges for the page's map."""
    fraction = envelope.time_fraction(centres(nside))
    return EnvelopeMap(nside, fraction, tuple(envelope.edges(at_end=False)), tuple(envelope.edges(at_end=True)))


def wanderers(p: Plan) -> tuple[Wanderer, ...]:
    """The Sun, and whatever else wanders through the envelope brighter than V 6: spots like stars that are in no catalogue."""
    request = p.request
    if request.start is None:
        return ()
    step_days = max(1.0, request.days / WAY_POINTS)
    found = exclusions(request.start, request.days, limit_mag=PLANET_MAG, step_days=step_days)
    inside = within(found, p.base.contains)
    return tuple(
        Wanderer(track.name, track.icrs, track.brightest_mag, float(inside[track.name].mean()))
        for track in found.tracks
        if track.name == SUN or inside[track.name].any()
    )


def way_deg(body: Wanderer) -> list[tuple[float, float]]:
    """RA and Dec along a body's way, degrees, for a page."""
    ra, dec = (np.degrees(a) for a in ra_dec_from_unit(body.track))
    return [(round(float(a), 3), round(float(d), 3)) for a, d in zip(ra, dec, strict=True)]


def _tolerance_rad(p: Plan) -> float:
    return p.request.query_tolerance_px * p.profile.camera.pixel_rad


def _blinded(p: Plan) -> dict[str, float]:
    if not isinstance(p.envelope, OccultedEnvelope):
        return {}
    b = p.envelope.blinded
    return {"earth": b.earth, "sun": b.sun, "moon": b.moon, "total": b.total}


def _finite(value: float | np.floating[Any]) -> float | None:
    return float(value) if np.isfinite(value) else None


def plain(values: dict[str, Any]) -> dict[str, Any]:
    """JSON knows neither NaN nor infinity."""
    return {name: _finite(value) if isinstance(value, float | np.floating) else value for name, value in values.items()}
