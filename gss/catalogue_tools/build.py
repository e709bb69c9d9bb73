"""From the real sky to a bank image with its manifest, and the quick look before it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from gss import __version__
from gss.catalogue_tools.distances import distance_table
from gss.catalogue_tools.healpix import centres
from gss.catalogue_tools.hipparcos import propagate
from gss.catalogue_tools.manifest import SOURCE, Manifest, profile_sha256
from gss.catalogue_tools.onboard import HEADER_BYTES, PAIR_BYTES, STAR_BYTES, encode, image_bytes, quantisation_error
from gss.catalogue_tools.quality import Quality, assess
from gss.catalogue_tools.request import BuildRequest, Plan, parameters_of, plan
from gss.catalogue_tools.selection import Fate, Selection, select
from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.stars import DistanceTable, StarTable

MAP_NSIDE = 32
FEWEST_STARS = 2
PAIR_SAMPLE = 800
# Room for the sampling error of the pair estimate before a build is refused without making the table.
SURE_OVERFLOW = 1.25

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class EnvelopeMap:
    """``fraction``: (12·nside²,) share of time in the field by HEALPix ring pixel. Edges: lines of (k, 3) ICRS directions."""

    nside: int
    fraction: Array
    edges_start: tuple[Array, ...]
    edges_end: tuple[Array, ...]


@dataclass(frozen=True)
class Preview:
    """The quick look: everything but the tables. ``pairs`` is an estimate above 800 stars."""

    plan: Plan
    selection: Selection
    pairs: int
    bytes: int
    map: EnvelopeMap


@dataclass(frozen=True)
class BuiltCatalogue:
    """A finished catalogue. ``stars``: the rows of the image, ``distances`` at full width."""

    plan: Plan
    image: bytes
    manifest: Manifest
    selection: Selection
    stars: StarTable
    distances: DistanceTable
    quality: Quality
    map: EnvelopeMap

    @property
    def sha256(self) -> str:
        """Hash of the image."""
        return self.manifest.image_sha256


def preview(request: BuildRequest, stars: StarTable) -> Preview:
    """Counts, funnel and map of a request, for a page that answers while parameters change."""
    p = plan(request)
    selection = _select(p, stars)
    kept = selection.kept
    pairs = estimate_pairs(kept.icrs, request.pair_min_rad, p.pair_max_rad)
    size = image_bytes(request.format_name, len(kept), pairs)
    return Preview(p, selection, pairs, size, _map(p))


def build(request: BuildRequest, stars: StarTable, progress: Progress | None = None) -> BuiltCatalogue:
    """The bank image of a request, its manifest and its quality. ``progress`` gets (stage, share done) before each
    stage and may raise to cancel; nothing is left behind then."""
    tell = progress or (lambda stage, share: None)
    tell("envelope", 0.0)
    p = plan(request)
    tell("selection", 0.1)
    selection = _select(p, stars)
    kept = selection.kept
    _check_kept(p, selection)
    tell("distances", 0.3)
    distances = distance_table(kept, request.pair_min_rad, p.pair_max_rad)
    tell("image", 0.5)
    image = encode(kept, distances, request.format_name, p.profile.name, bytes.fromhex(profile_sha256(p.profile))[:8])
    _check_size(p, len(image))
    tell("quality", 0.6)
    tolerance_rad = request.query_tolerance_px * p.profile.camera.pixel_rad
    rng = np.random.default_rng(request.seed)
    quality = assess(kept.icrs, p.envelope, p.shape, request.pointings, rng, distances, tolerance_rad)
    tell("map", 0.9)
    envelope_map = _map(p)
    manifest = _manifest(p, selection, kept, distances, image, quality)
    tell("done", 1.0)
    return BuiltCatalogue(p, image, manifest, selection, kept, distances, quality, envelope_map)


def estimate_pairs(unit: Array, min_rad: float, max_rad: float) -> int:
    """Number of pairs within the limits: counted for up to 800 stars, else scaled up from 800 evenly chosen ones."""
    n = len(unit)
    if n < 2:
        return 0
    sample = unit[np.unique(np.linspace(0, n - 1, min(n, PAIR_SAMPLE)).astype(int))]
    tree = cKDTree(unit)
    near, far = 2 * np.sin(min_rad / 2), 2 * np.sin(min(max_rad, np.pi) / 2)
    within = tree.query_ball_point(sample, far, return_length=True) - tree.query_ball_point(
        sample, near * (1 - 1e-12), return_length=True
    )
    # With no lower limit each star would find itself, which the inner count takes off again.
    return round(float(within.sum()) * n / len(sample) / 2)


def _select(p: Plan, stars: StarTable) -> Selection:
    rules = p.request.rules
    at_epoch = propagate(stars.take(stars.v_mag <= rules.faint_mag) if len(stars) else stars, p.epoch_jyear)
    return select(at_epoch, p.envelope, rules, p.shape.equal_circle_rad)


def _check_kept(p: Plan, selection: Selection) -> None:
    if selection.count(Fate.OUTSIDE) == len(selection.candidates):
        raise BadInput(
            "the envelope holds no star",
            expected="at least one within the limits",
            got=f"0 of {len(selection.candidates)}",
            hint="wider limits or a fainter magnitude limit",
        )
    kept = selection.count(Fate.KEPT)
    if kept < FEWEST_STARS:
        raise BadInput(
            "too few stars are left", expected=f"at least {FEWEST_STARS}", got=str(kept), hint="looser rules"
        )
    pairs = estimate_pairs(selection.kept.icrs, p.request.pair_min_rad, p.pair_max_rad)
    sure = image_bytes(p.request.format_name, kept, int(pairs / SURE_OVERFLOW))
    _check_size(p, sure)


def _check_size(p: Plan, size: int) -> None:
    if size > p.bank_bytes:
        raise BadInput(
            "the catalogue overflows the bank",
            expected=f"at most {p.bank_bytes} bytes",
            got=f"{size} bytes",
            hint="a brighter limit, fewer stars per field, a narrower envelope or shorter distances",
        )


def _map(p: Plan) -> EnvelopeMap:
    fraction = p.envelope.time_fraction(centres(MAP_NSIDE))
    return EnvelopeMap(MAP_NSIDE, fraction, tuple(p.envelope.edges(at_end=False)), tuple(p.envelope.edges(at_end=True)))


def _manifest(
    p: Plan, selection: Selection, kept: StarTable, distances: DistanceTable, image: bytes, quality: Quality
) -> Manifest:
    request, error = p.request, quantisation_error(kept, distances, image)
    return Manifest(
        name=request.name,
        author=request.author,
        tool=f"gss {__version__}",
        format_name=request.format_name,
        profile_name=p.profile.name,
        profile_sha256=profile_sha256(p.profile),
        source=SOURCE,
        star_table_sha256=_star_table_sha256(),
        frame="ICRS",
        epoch_jyear=p.epoch_jyear,
        valid_from=p.valid_from.isoformat() if p.valid_from else "",
        valid_to=p.valid_to.isoformat() if p.valid_to else "",
        parameters=parameters_of(request),
        envelope=_envelope_facts(p),
        counts={"stars": len(kept), "pairs": len(distances)} | {f.label: f.stars for f in selection.funnel},
        bytes_by_part={
            "header": HEADER_BYTES,
            "stars": len(kept) * STAR_BYTES[request.format_name],
            "distances": len(distances) * PAIR_BYTES,
        },
        quality=_quality_facts(quality),
        quantisation={
            "position_rad": error.position_rad,
            "distance_rad": error.distance_rad,
            "v_mag": None if np.isnan(error.v_mag) else error.v_mag,
        },
        hip=tuple(int(h) for h in kept.hip),
        image_sha256=hashlib.sha256(image).hexdigest(),
    )


def _envelope_facts(p: Plan) -> dict[str, Any]:
    facts: dict[str, Any] = {"kind": type(p.envelope).__name__, "pair_max_rad": p.pair_max_rad}
    if p.planes is not None:
        facts["inclination_rad"] = list(p.planes.inclination_rad)
        facts["raan_rad"] = list(p.planes.raan_rad)
    return facts


def _quality_facts(quality: Quality) -> dict[str, Any]:
    return {
        "pointings": quality.pointings,
        "histogram": quality.histogram.tolist(),
        "mean": quality.mean,
        "p_fewer_than_3": quality.p_fewer_than(3),
        "p_fewer_than_5": quality.p_fewer_than(5),
        "worst_stars": quality.worst_stars,
        "worst_ra_rad": quality.worst_ra_rad,
        "worst_dec_rad": quality.worst_dec_rad,
        "worst_roll_rad": quality.worst_roll_rad,
        "candidates_per_query": quality.candidates_per_query,
    }


def _star_table_sha256() -> str:
    return hashlib.sha256((files("gss.catalogue_tools") / "data" / "stars.npz").read_bytes()).hexdigest()
