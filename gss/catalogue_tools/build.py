"""Build a bank image with its manifest from a star source, and compute the preview of a request."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np

from gss import __version__
from gss.catalogue_tools.corrections.sky_source import CorrectedSky, corrected
from gss.catalogue_tools.envelope.blocks import BlockEnvelope
from gss.catalogue_tools.envelope.envelope import Envelope
from gss.catalogue_tools.manifest import BuildManifest, profile_sha256
from gss.catalogue_tools.onboard import (
    OwnTables,
    encode,
    format_of,
    image_bytes,
    part_bytes,
    quantisation_error,
    tables_for,
)
from gss.catalogue_tools.plan import BuildPlan, plan
from gss.catalogue_tools.quick_look import QuickLook
from gss.catalogue_tools.request import BuildRequest, parameters_of
from gss.catalogue_tools.selection.ambiguity import AmbiguityMap
from gss.catalogue_tools.selection.assessment import MAP_NSIDE as MAP_NSIDE
from gss.catalogue_tools.selection.assessment import Assessment, ambiguity, assess_catalogue, envelope_map
from gss.catalogue_tools.selection.assessment import EnvelopeMap as EnvelopeMap
from gss.catalogue_tools.selection.quality import Quality
from gss.catalogue_tools.selection.selection import Fate, Selection, frame_looks, screening_facts, select
from gss.catalogue_tools.size_estimate import estimate_pairs as estimate_pairs
from gss.catalogue_tools.size_estimate import estimated, frame_for, searched
from gss.catalogue_tools.sources.sources import StarSource, hipparcos_of
from gss.domain.callbacks import no_progress
from gss.domain.errors import BadInput
from gss.domain.stars import StarTable
from gss.skytables.bank import ReducedCatalogue
from gss.skytables.pairs import DistanceTable, distance_table

MIN_STARS = 2
# A coarser map than that of a build. It is fast enough for the page while the user changes parameters.
MISTAKES_NSIDE = 8
# Upper limits for a preview: number of stepped fields, and number of stars tested in frames.
MAX_FIELDS, MAX_TESTED_STARS = 2_000, 2_000_000
# The number of pairs is estimated from a sample. A build is rejected before its table is computed only if the estimate
# exceeds the limit by this factor.
SURE_OVERFLOW = 1.25

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Preview:
    """Preview of a request: all results except the tables. ``pairs`` is an estimate if there are more than 800 stars.
    ``ambiguity``: coarse map, None if not requested."""

    plan: BuildPlan
    selection: Selection
    pairs: int
    bytes: int
    map: EnvelopeMap
    ambiguity: AmbiguityMap | None


@dataclass(frozen=True)
class BuiltCatalogue:
    """A finished catalogue. ``stars``: rows of the image, in the image's frame. ``distances``: distance table at full
    precision."""

    plan: BuildPlan
    image: bytes
    manifest: BuildManifest
    selection: Selection
    stars: StarTable
    distances: DistanceTable
    assessment: Assessment

    @property
    def sha256(self) -> str:
        """Hash of the image."""
        return self.manifest.image_sha256

    @property
    def quality(self) -> Quality:
        """Statistics of the number of stars per field."""
        return self.assessment.quality

    @property
    def map(self) -> EnvelopeMap:
        """Map of the envelope."""
        return self.assessment.map


@dataclass(frozen=True)
class Prepared:
    """A request that has passed its checks, with its sky and its selected stars."""

    plan: BuildPlan
    source: StarSource
    sky: CorrectedSky
    selection: Selection


def prepare(request: BuildRequest, source: StarSource | StarTable, progress: Progress | None = None) -> Prepared:
    """Plan the request and select its stars. Raises BadInput if the selection already shows that the catalogue cannot
    be built.

    ``progress``: as for :func:`build`, up to 0.3.
    """
    report = progress or (lambda stage, share: None)
    build_plan, origin = plan(request, lambda share: report("envelope", 0.2 * share)), _source(source)
    sky, selection = _select(
        build_plan, origin, build_plan.envelope, lambda share: report("thinning", 0.2 + 0.1 * share)
    )
    _check_kept(build_plan, selection)
    return Prepared(build_plan, origin, sky, selection)


def preview(request: BuildRequest, source: StarSource | StarTable, *, mistakes: bool = False) -> Preview:
    """Compute counts, funnel and map of a request. This is fast enough for a page that is updated while the user
    changes parameters. ``mistakes``: True to also compute a coarse map of the sky regions in which stars can be
    confused. Raises BadInput if the request is too expensive for a preview.
    """
    build_plan, origin = plan(request), _source(source)
    if (reason := too_heavy(build_plan, origin)) is not None:
        raise reason
    quick_look = QuickLook(build_plan)
    _, selection = _select(build_plan, origin, quick_look)
    stars = selection.kept
    pairs, size = estimated(build_plan, stars)
    coarse = ambiguity(build_plan, quick_look, searched(build_plan, stars), MISTAKES_NSIDE) if mistakes else None
    return Preview(build_plan, selection, pairs, size, envelope_map(quick_look, quick_look.nside), coarse)


def build(request: BuildRequest, source: StarSource | StarTable, progress: Progress | None = None) -> BuiltCatalogue:
    """Build the bank image of a request, its manifest and its quality figures.

    ``progress`` is called with (stage, fraction done) before each stage. It can raise an exception to cancel the build;
    nothing is stored in that case.
    """
    report = progress or (lambda stage, share: None)
    report("envelope", 0.0)
    return finish(prepare(request, source, report), report)


def finish(ready: Prepared, progress: Progress | None = None) -> BuiltCatalogue:
    """Complete a build from a prepared request: tables, image, quality and manifest."""
    report = progress or (lambda stage, share: None)
    build_plan, sky, selection = ready.plan, ready.sky, ready.selection
    request, stars = build_plan.request, sky.in_frame(selection.kept)
    report("distances", 0.3)
    pairs = distance_table(stars, request.pair_min_rad, build_plan.pair_max_rad)
    camera, name = build_plan.profile.camera, request.format_name
    catalogue_tables = tables_for(name, stars, pairs, camera, reduced=request.reduced, index=request.k_vector)
    report("image", 0.5)
    key = bytes.fromhex(profile_sha256(build_plan.profile))[:8]
    image = encode(stars, catalogue_tables.distances, name, build_plan.profile.name, key, catalogue_tables.tables)
    _check_size(build_plan, len(image))
    report("quality", 0.6)
    reduced = catalogue_tables.tables.reduced
    # If there is a reduced catalogue, the device searches only the reduced catalogue, and only the pairs of its stars
    # are on board.
    directory = selection.kept if reduced is None else selection.kept.take(reduced.kept)
    assessment = assess_catalogue(
        build_plan, selection.kept, pairs if reduced is None else catalogue_tables.distances, directory
    )
    report("manifest", 0.95)
    manifest = _manifest(build_plan, ready.source, sky, selection, stars, catalogue_tables, image, assessment)
    report("done", 1.0)
    return BuiltCatalogue(build_plan, image, manifest, selection, stars, catalogue_tables.distances, assessment)


def _source(source: StarSource | StarTable) -> StarSource:
    return hipparcos_of(source) if isinstance(source, StarTable) else source


def too_heavy(build_plan: BuildPlan, source: StarSource | StarTable) -> BadInput | None:
    """Return the error for a request too expensive for an interactive preview, or None. The cost is estimated, not
    measured."""
    base = build_plan.base
    fields = base.looked_at if isinstance(base, BlockEnvelope) else 0
    stars = int(np.count_nonzero(_source(source).stars.v_mag <= build_plan.request.rules.faint_mag))
    tested_stars = round(frame_looks(stars, build_plan.request.rules, build_plan.shape))
    for count, limit, quantity in (
        (fields, MAX_FIELDS, "fields of the blocks"),
        (tested_stars, MAX_TESTED_STARS, "stars in frames"),
    ):
        if count > limit:
            return BadInput(
                f"too many combinations for a preview: {count}",
                expected=f"at most {limit} {quantity}",
                got=str(count),
                hint="build it as a job, or choose narrower limits, fewer stars or the exact method",
            )
    return None


def _select(
    build_plan: BuildPlan, source: StarSource, envelope: Envelope, report: Callable[[float], None] = no_progress
) -> tuple[CorrectedSky, Selection]:
    rules, corrections, stars = build_plan.request.rules, build_plan.request.corrections, source.stars
    if rules.faint_mag > source.faintest_v_mag:
        raise BadInput(
            "the star table does not reach this magnitude limit",
            expected=f"V ≤ {source.faintest_v_mag:g}",
            got=f"{rules.faint_mag:g}",
            hint="use a brighter limit or a deeper source",
        )
    if build_plan.request.depth_mag is not None and len(stars):
        stars = stars.take(stars.v_mag <= rules.faint_mag)
    sky = corrected(
        stars, corrections, build_plan.epoch_jyear, date_jyear=build_plan.date_jyear, profile=build_plan.profile
    )
    selection = select(sky.icrs_stars, envelope, rules, build_plan.shape, report)
    blends = int(np.count_nonzero(sky.rejected.v_mag <= rules.faint_mag))
    return sky, selection.from_source(source.title, source.count, blends)


def _check_kept(build_plan: BuildPlan, selection: Selection) -> None:
    if selection.count(Fate.OUTSIDE) == len(selection.candidates):
        raise BadInput(
            "no star lies in the envelope",
            expected="at least one within the limits",
            got=f"0 of {len(selection.candidates)}",
            hint="use wider limits or a fainter magnitude limit",
        )
    count = selection.count(Fate.KEPT)
    if count < MIN_STARS:
        raise BadInput(
            "too few stars are left",
            expected=f"at least {MIN_STARS}",
            got=str(count),
            hint="relax the selection rules",
        )
    request = build_plan.request
    # With a reduced catalogue, only the pairs of its stars are stored. Their number is not known here, because these
    # stars are selected later.
    reduced = frame_for(request.format_name, build_plan.profile.camera, request.reduced)
    if format_of(request.format_name).pair_bytes and reduced is None:
        pairs = estimate_pairs(selection.kept.icrs, build_plan.request.pair_min_rad, build_plan.pair_max_rad)
        _check_size(build_plan, image_bytes(build_plan.request.format_name, count, int(pairs / SURE_OVERFLOW)))


def _check_size(build_plan: BuildPlan, size: int) -> None:
    if size > build_plan.bank_bytes:
        raise BadInput(
            "the catalogue is too large for the bank",
            expected=f"at most {build_plan.bank_bytes} bytes",
            got=f"{size} bytes",
            hint="use a brighter limit, fewer stars per field, a narrower envelope or shorter distances",
        )


def _manifest(
    build_plan: BuildPlan,
    source: StarSource,
    sky: CorrectedSky,
    selection: Selection,
    stars: StarTable,
    catalogue_tables: OwnTables,
    image: bytes,
    assessment: Assessment,
) -> BuildManifest:
    request, error = build_plan.request, quantisation_error(stars, catalogue_tables.distances, image)
    counts = {"stars": len(stars), "pairs": len(catalogue_tables.distances)}
    if catalogue_tables.tables.reduced is not None:
        counts["reduced catalogue"] = int(np.count_nonzero(catalogue_tables.tables.reduced.kept))
    hidden = request.occultation
    return BuildManifest(
        name=request.name,
        author=request.author,
        tool=f"gss {__version__}",
        format_name=request.format_name,
        profile_name=build_plan.profile.name,
        profile_sha256=profile_sha256(build_plan.profile),
        source=str(source.facts.get("source", source.title)),
        star_table_sha256=source.sha256,
        frame=sky.frame,
        epoch_jyear=build_plan.epoch_jyear,
        valid_from=build_plan.valid_from.isoformat() if build_plan.valid_from else "",
        valid_to=build_plan.valid_to.isoformat() if build_plan.valid_to else "",
        parameters=parameters_of(request),
        envelope=_envelope_facts(build_plan),
        counts=counts | {f.label: f.stars for f in selection.funnel},
        bytes_by_part=part_bytes(image),
        quality=_quality_facts(assessment.quality),
        quantisation={
            "position_rad": error.position_rad,
            "distance_rad": error.distance_rad,
            "v_mag": None if np.isnan(error.v_mag) else error.v_mag,
        },
        hip=tuple(int(h) for h in stars.hip),
        image_sha256=hashlib.sha256(image).hexdigest(),
        corrections=dict(sky.facts),
        source_facts={"name": source.name, **source.facts},
        occultation=dict(vars(hidden)) if hidden.active else {},
        method=request.method,
        assessment=assessment.facts() | _choice_facts(selection, catalogue_tables.tables.reduced),
    )


def _choice_facts(selection: Selection, reduced: ReducedCatalogue | None) -> dict[str, object]:
    """Return the results of the screening and the frame of the reduced catalogue; empty if the build has neither."""
    facts: dict[str, object] = {}
    if (screening := screening_facts(selection)) is not None:
        facts["screening"] = screening
    if reduced is not None:
        facts["reduced"] = asdict(reduced.frame) | {"stars": int(np.count_nonzero(reduced.kept))}
    return facts


def _envelope_facts(build_plan: BuildPlan) -> dict[str, object]:
    facts: dict[str, object] = {"kind": type(build_plan.base).__name__, "pair_max_rad": build_plan.pair_max_rad}
    if build_plan.planes is not None:
        facts["inclination_rad"] = list(build_plan.planes.inclination_rad)
        facts["raan_rad"] = list(build_plan.planes.raan_rad)
        if (ellipse := build_plan.planes.ellipse) is not None:
            facts["eccentricity"] = ellipse.eccentricity
            facts["perigee_rad"] = [ellipse.perigee_start_rad, ellipse.perigee_end_rad]
    return facts


def _quality_facts(quality: Quality) -> dict[str, object]:
    per_star = quality.candidates_per_star
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
        "candidates_per_star": float(per_star) if np.isfinite(per_star) else None,
        "blinded_share": quality.blinded_share,
        "searched": quality.searched,
    }
