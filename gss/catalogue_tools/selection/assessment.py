"""Assess a catalogue before upload: stars per field, ambiguity, lifetime, map, planets in the envelope."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gss.catalogue_tools.corrections.exclusions import exclusions, within
from gss.catalogue_tools.envelope.envelope import Envelope
from gss.catalogue_tools.envelope.healpix import centres
from gss.catalogue_tools.envelope.lifetime import Lifetime
from gss.catalogue_tools.envelope.occultation import OccultedEnvelope
from gss.catalogue_tools.plan import BuildPlan
from gss.catalogue_tools.selection.ambiguity import AmbiguityMap, ambiguity_map
from gss.catalogue_tools.selection.quality import Quality, assess
from gss.domain.angles import Array, ra_dec_from_unit
from gss.domain.stars import StarTable
from gss.skytables.pairs import DistanceTable

MAP_NSIDE = 32
AMBIGUITY_NSIDE = 16
# Magnitude limit of reported planets. Many stars are as bright as a fainter planet.
PLANET_MAG = 6.0
SUN = "Sun"
WAY_POINTS = 60


@dataclass(frozen=True)
class EnvelopeMap:
    """Map of an envelope. ``fraction``: (12·nside²,) fraction of time in the field by HEALPix ring pixel.
    ``edges_start``, ``edges_end``: lines of (k, 3) ICRS directions."""

    nside: int
    fraction: Array
    edges_start: tuple[Array, ...]
    edges_end: tuple[Array, ...]


@dataclass(frozen=True)
class MovingBody:
    """The Sun, or another body that is in the envelope at some time.

    ``track``: (k, 3) ICRS directions from the first to the last day. ``share``: fraction of the days on which it is in
    the envelope.
    """

    name: str
    track: Array
    brightest_mag: float
    share: float


@dataclass(frozen=True)
class Assessment:
    """Result of the assessment. ``ambiguity`` is None if there are fewer than three stars. ``blinded``: fraction of
    time for which the camera is blinded, by body; {} if none."""

    quality: Quality
    map: EnvelopeMap
    ambiguity: AmbiguityMap | None
    lifetime: Lifetime
    blinded: dict[str, float]
    wanderers: tuple[MovingBody, ...]

    def facts(self) -> dict[str, object]:
        """Return plain values for the manifest."""
        return {
            "lifetime_days": _finite(self.lifetime.days),
            "lifetime_until": self.lifetime.until.isoformat() if self.lifetime.until else None,
            "lifetime_threshold": self.lifetime.threshold,
            "ambiguity": None if self.ambiguity is None else plain(self.ambiguity.facts()),
            "blinded": self.blinded,
            "wanderers": [{"name": w.name, "brightest_mag": w.brightest_mag, "share": w.share} for w in self.wanderers],
        }


def assess_catalogue(
    plan: BuildPlan, stars: StarTable, distances: DistanceTable, directory: StarTable | None = None
) -> Assessment:
    """Assess the stars in ICRS axes and their distances over the whole envelope of the plan.

    ``directory``: the stars that the device searches, which are the stars that can be confused; None: all.
    """
    rng = np.random.default_rng(plan.request.seed)
    quality = assess(
        stars.icrs, plan.envelope, plan.shape, plan.request.pointings, rng, distances, _tolerance_rad(plan)
    )
    mistakes = ambiguity(plan, plan.envelope, stars if directory is None else directory, AMBIGUITY_NSIDE)
    return Assessment(quality, envelope_map(plan.envelope), mistakes, plan.lifetime(), _blinded(plan), wanderers(plan))


def ambiguity(plan: BuildPlan, envelope: Envelope, stars: StarTable, nside: int) -> AmbiguityMap | None:
    """Compute the map of the regions in which selected stars can be confused with others; None for fewer than three
    stars."""
    if len(stars) < 3:
        return None
    radius, longest = plan.shape.equal_circle_rad, plan.pair_max_rad
    return ambiguity_map(stars.icrs, envelope, radius, _tolerance_rad(plan), longest, nside=nside)


def envelope_map(envelope: Envelope, nside: int = MAP_NSIDE) -> EnvelopeMap:
    """Compute the fraction of time and the edges for the page's map."""
    fraction = envelope.time_fraction(centres(nside))
    return EnvelopeMap(nside, fraction, tuple(envelope.edges(at_end=False)), tuple(envelope.edges(at_end=True)))


def wanderers(plan: BuildPlan) -> tuple[MovingBody, ...]:
    """Return the Sun and all other bodies brighter than V 6 that cross the envelope; their images look like stars but
    catalogues do not contain them."""
    request = plan.request
    if request.start is None:
        return ()
    step_days = max(1.0, request.days / WAY_POINTS)
    tracks = exclusions(request.start, request.days, limit_mag=PLANET_MAG, step_days=step_days)
    inside = within(tracks, plan.base.contains)
    return tuple(
        MovingBody(track.name, track.icrs, track.brightest_mag, float(inside[track.name].mean()))
        for track in tracks.tracks
        if track.name == SUN or inside[track.name].any()
    )


def way_deg(body: MovingBody) -> list[tuple[float, float]]:
    """Return (RA, Dec) along a body's track in degrees, for a page."""
    ra, dec = (np.degrees(a) for a in ra_dec_from_unit(body.track))
    return [(round(float(a), 3), round(float(d), 3)) for a, d in zip(ra, dec, strict=True)]


def _tolerance_rad(plan: BuildPlan) -> float:
    return plan.request.query_tolerance_px * plan.profile.camera.pixel_rad


def _blinded(plan: BuildPlan) -> dict[str, float]:
    if not isinstance(plan.envelope, OccultedEnvelope):
        return {}
    b = plan.envelope.blinded
    return {"earth": b.earth, "sun": b.sun, "moon": b.moon, "total": b.total}


def _finite(value: float | np.floating[Any]) -> float | None:
    return float(value) if np.isfinite(value) else None


def plain(values: dict[str, object]) -> dict[str, object]:
    """Replace NaN and infinity by None, because JSON has neither."""
    return {name: _finite(value) if isinstance(value, float | np.floating) else value for name, value in values.items()}
