"""Report of a built catalogue as plain values for pages and papers. Angles are in degrees because the values are only
displayed."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from pydantic import BaseModel
from typing_extensions import TypedDict  # pydantic needs this one before Python 3.12

from gss.catalogue_tools.build import BuiltCatalogue, Preview, build
from gss.catalogue_tools.envelope.lifetime import Lifetime
from gss.catalogue_tools.envelope.sweep import outlines, sweep
from gss.catalogue_tools.manifest import BuildManifest
from gss.catalogue_tools.plan import BuildPlan
from gss.catalogue_tools.request import request_from
from gss.catalogue_tools.selection.ambiguity import AmbiguityMap
from gss.catalogue_tools.selection.assessment import Assessment, EnvelopeMap, way_deg
from gss.catalogue_tools.selection.quality import Quality
from gss.catalogue_tools.selection.selection import Fate, ScreeningFacts, Selection, screening_facts
from gss.catalogue_tools.sources.sources import StarSource
from gss.domain.angles import ARCSEC_RAD, ra_dec_from_unit
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import CorruptData
from gss.domain.frames import cam_from_icrs
from gss.domain.json_object import JsonObject
from gss.domain.stars import StarTable

MAX_ON_MAP = 4000
MAX_FIGURE = 1e6
CURVE_POINTS = 60


Outline = list[tuple[float, float]]
"""Points of an outline on the sky: (RA, Dec) in degrees."""


class FunnelValues(TypedDict):
    """Number of stars after a step of the selection."""

    label: str
    stars: int
    kind: Literal["keep", "drop"]


class MapStar(TypedDict):
    """A candidate star. ``state``: kept, thinned, rejected or outside."""

    hip: int
    ra_deg: float
    dec_deg: float
    v_mag: float
    state: str


class EnvelopeValues(TypedDict):
    """Envelope. ``fraction``: for each sky pixel in HEALPix ring order, fraction of the time in which the pixel is in
    the field of view. ``sweep``: outlines of the field of view along the orbit. ``boresights``: boresights of these
    outlines. ``sweep_over``: time span of the outlines, one orbit or the period of validity. ``sweep`` is [] for the
    whole sky and for catalogues of older versions."""

    nside: int
    fraction: list[float]
    outline_start: list[Outline]
    outline_end: list[Outline]
    sweep_over: str
    sweep: list[Outline]
    boresights: Outline


class ChoiceValues(TypedDict):
    """Result of the star selection, with maps."""

    funnel: list[FunnelValues]
    sky: list[MapStar]
    envelope: EnvelopeValues


class QualityValues(TypedDict):
    """Statistics of star counts in the fields of view. ``searched``: number of fields examined in the search for the worst
    field. ``worst_roll_deg``: None for catalogues built by an older version."""

    pointings: int
    histogram: list[int]
    mean: float
    p_fewer_than_3: float
    p_fewer_than_5: float
    worst_stars: int
    worst_ra_deg: float
    worst_dec_deg: float
    worst_roll_deg: float | None
    candidates_per_query: float | None
    candidates_per_star: float | None
    blinded_share: float
    searched: int


class QualityReport(QualityValues):
    """Statistics of star counts, and the outline of the field with the fewest stars."""

    worst_outline: Outline


class AmbiguityValues(TypedDict):
    """Ambiguity per sky pixel in HEALPix ring order. ``value``: number of wrong triangles per triangle of a field's brightest
    stars. ``pairs``: number of wrong pairs per pair. None outside the envelope."""

    nside: int
    tolerance_arcsec: float
    value: list[float | None]
    pairs: list[float | None]
    worst: float | None
    worst_ra_deg: float | None
    worst_dec_deg: float | None


class LifetimeValues(TypedDict):
    """Fraction of stars within the position tolerance, by days after the end of validity. ``days``, ``until``: time at which the
    fraction falls to ``threshold``; None if this is beyond the curve."""

    threshold: float
    days: float | None
    until: str | None
    days_curve: list[float]
    share_curve: list[float]


class SizeValues(TypedDict):
    """Sizes of the image's parts and of the bank, in bytes."""

    by_part: dict[str, int]
    bank_bytes: int | None


class WandererValues(TypedDict):
    """The Sun or another moving body. ``share``: fraction of the days on which the body is in the envelope. ``way``:
    path of the body in degrees, from the first to the last day."""

    name: str
    brightest_mag: float
    share: float
    way: Outline


class PreviewReport(ChoiceValues):
    """Report of a preview."""

    ambiguity: AmbiguityValues | None


class CatalogueReport(PreviewReport):
    """Report of a built catalogue."""

    quality: QualityReport
    lifetime: LifetimeValues
    sizes: SizeValues
    blinded: dict[str, float]
    wanderers: list[WandererValues]
    screening: ScreeningFacts | None


class StoredReport(BaseModel):
    """Report of a stored catalogue. A catalogue that was read back from the device has no report. Reports stored by
    older versions lack parts."""

    funnel: list[FunnelValues]
    sky: list[MapStar]
    envelope: EnvelopeValues | None
    quality: QualityReport | None
    ambiguity: AmbiguityValues | None
    lifetime: LifetimeValues | None
    sizes: SizeValues | None
    blinded: dict[str, float]
    wanderers: list[WandererValues]
    screening: ScreeningFacts | None


ADDED_TO_ENVELOPE: JsonObject = {"sweep_over": "", "sweep": [], "boresights": []}
ADDED_TO_QUALITY: JsonObject = {
    "worst_roll_deg": None,
    "worst_outline": [],
    "candidates_per_star": None,
    "blinded_share": 0.0,
    "searched": 0,
}
"""Values that older versions did not store."""


def stored_report(stored: JsonObject) -> StoredReport:
    """Return a stored report. Missing parts are empty or None."""
    envelope, quality = stored.get("envelope"), stored.get("quality")
    return StoredReport(
        funnel=stored.get("funnel", []),
        sky=stored.get("sky", []),
        envelope=envelope and ADDED_TO_ENVELOPE | envelope,
        quality=quality and ADDED_TO_QUALITY | quality,
        ambiguity=stored.get("ambiguity"),
        lifetime=stored.get("lifetime"),
        sizes=stored.get("sizes"),
        blinded=stored.get("blinded", {}),
        wanderers=stored.get("wanderers", []),
        screening=stored.get("screening"),
    )


def preview_report(quick: Preview) -> PreviewReport:
    """Return the selection, maps and ambiguity of a preview."""
    return {
        **_choice(quick.selection, quick.map, quick.plan),
        "ambiguity": None if quick.ambiguity is None else _ambiguity(quick.ambiguity),
    }


def report_of(built: BuiltCatalogue) -> CatalogueReport:
    """Return the complete report of a built catalogue."""
    assessment: Assessment = built.assessment
    return {
        **_choice(built.selection, built.map, built.plan),
        "quality": {**_quality(assessment.quality), "worst_outline": _worst_outline(built.plan, assessment.quality)},
        "ambiguity": None if assessment.ambiguity is None else _ambiguity(assessment.ambiguity),
        "lifetime": _lifetime(assessment.lifetime),
        "sizes": {"by_part": built.manifest.bytes_by_part, "bank_bytes": built.plan.bank_bytes},
        "blinded": assessment.blinded,
        "wanderers": [
            {"name": w.name, "brightest_mag": round(w.brightest_mag, 2), "share": round(w.share, 4), "way": way_deg(w)}
            for w in assessment.wanderers
        ],
        "screening": screening_facts(built.selection),
    }


def report_again(manifest: BuildManifest, camera: CameraProfile, source: StarSource | StarTable) -> CatalogueReport:
    """Repeat the build of a catalogue from its manifest and return the report.

    Raises CorruptData if the new image differs from the catalogue's image."""
    built = build(request_from(manifest.parameters, camera), source)
    if built.sha256 != manifest.image_sha256:
        raise CorruptData(
            "the same request does not reproduce this image",
            expected=manifest.image_sha256,
            got=built.sha256,
            hint=f"use {manifest.tool}, which built it, or the same star list",
        )
    return report_of(built)


def _choice(selection: Selection, envelope: EnvelopeMap, plan: BuildPlan) -> ChoiceValues:
    swept = sweep(plan.base, plan.shape)
    return {
        "funnel": [
            {"label": f.label, "stars": f.stars, "kind": "drop" if f.dropped else "keep"} for f in selection.funnel
        ],
        "sky": _sky(selection),
        "envelope": {
            "nside": envelope.nside,
            "fraction": [round(float(x), 4) for x in envelope.fraction],
            "outline_start": [_line(edge) for edge in envelope.edges_start],
            "outline_end": [_line(edge) for edge in envelope.edges_end],
            "sweep_over": swept.over,
            "sweep": [_line(field, 2) for field in swept.fields],
            "boresights": _line(swept.boresights, 2) if len(swept.boresights) else [],
        },
    }


def _quality(quality: Quality) -> QualityValues:
    return {
        "pointings": quality.pointings,
        "histogram": [int(n) for n in quality.histogram],
        "mean": quality.mean,
        "p_fewer_than_3": quality.p_fewer_than(3),
        "p_fewer_than_5": quality.p_fewer_than(5),
        "worst_stars": quality.worst_stars,
        "worst_ra_deg": float(np.degrees(quality.worst_ra_rad)),
        "worst_dec_deg": float(np.degrees(quality.worst_dec_rad)),
        "worst_roll_deg": float(np.degrees(quality.worst_roll_rad)),
        "candidates_per_query": _finite(quality.candidates_per_query),
        "candidates_per_star": _finite(quality.candidates_per_star),
        "blinded_share": quality.blinded_share,
        "searched": quality.searched,
    }


def _ambiguity(ambiguity: AmbiguityMap) -> AmbiguityValues:
    """Return the ambiguity map as plain values. ``value`` is None for a pixel without data and ``MAX_FIGURE`` for a pixel with
    fewer than three stars."""
    ra_rad, dec_rad, worst_value = ambiguity.worst
    return {
        "nside": ambiguity.nside,
        "tolerance_arcsec": ambiguity.tolerance_rad / ARCSEC_RAD,
        "value": [_rounded(x) for x in ambiguity.wrong_triangles],
        "pairs": [_rounded(x) for x in ambiguity.wrong_pairs],
        "worst": _rounded(worst_value),
        "worst_ra_deg": _finite(np.degrees(ra_rad)),
        "worst_dec_deg": _finite(np.degrees(dec_rad)),
    }


def _lifetime(life: Lifetime) -> LifetimeValues:
    step = max(1, len(life.days_curve) // CURVE_POINTS)
    return {
        "threshold": life.threshold,
        "days": _finite(life.days),
        "until": life.until.isoformat() if life.until else None,
        "days_curve": [round(float(x), 3) for x in life.days_curve[::step]],
        "share_curve": [round(float(x), 5) for x in life.share_curve[::step]],
    }


def _sky(selection: Selection) -> list[MapStar]:
    stars = selection.candidates
    ra, dec = (np.degrees(a) for a in ra_dec_from_unit(stars.icrs))
    return [
        {
            "hip": int(stars.hip[k]),
            "ra_deg": round(float(ra[k]), 4),
            "dec_deg": round(float(dec[k]), 4),
            "v_mag": round(float(stars.v_mag[k]), 2),
            "state": Fate(int(selection.fate[k])).map_state,
        }
        for k in range(min(len(stars), MAX_ON_MAP))
    ]


def _worst_outline(plan: BuildPlan, quality: Quality) -> list[tuple[float, float]]:
    """Return the outline on the sky of the field with the fewest stars."""
    attitude = cam_from_icrs(quality.worst_ra_rad, quality.worst_dec_rad, quality.worst_roll_rad)
    return _line(outlines(plan.shape, attitude[None])[0], 2)


def _line(edge: Any, decimals: int = 3) -> list[tuple[float, float]]:
    ra, dec = (np.degrees(a) for a in ra_dec_from_unit(np.asarray(edge)))
    return [
        (round(float(a), decimals), round(float(d), decimals))
        for a, d in zip(np.atleast_1d(ra), np.atleast_1d(dec), strict=True)
    ]


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _rounded(value: float) -> float | None:
    """Return the value rounded to three digits. NaN becomes None, infinity becomes ``MAX_FIGURE``."""
    return None if np.isnan(value) else float(f"{min(float(value), MAX_FIGURE):.3g}")
