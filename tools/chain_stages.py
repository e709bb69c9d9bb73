"""Stages of each system's chain in execution order, for docs/chains.md."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class ChainStage:
    """One stage of a chain. ``what``: description; ``where``: module:function under gss.pipeline; ``source``: section
    of the publication; ``reach``: options that select the stage; of several alternatives, the first is tested; ``left_out_by``:
    option that disables the stage; ``scene``: images that need the stage (see :class:`tools.chains_reach.Scene`);
    ``by_unit``: True if only the simulated unit runs it."""

    what: str
    where: str
    source: str
    reach: str = ""
    left_out_by: str = ""
    scene: str = "plain"
    by_unit: bool = False

    @property
    def full_name(self) -> str:
        """Full name of the function as module:name."""
        return self.where if self.where.startswith("gss.") else f"gss.pipeline.{self.where}"

    @property
    def selected_with(self) -> str:
        """Text of the column *selected with* on the page."""
        return f"`{self.left_out_by}` leaves it out" if self.left_out_by else self.reach or "always"


LOST, NEAR, TRACKED = "without `--hint`", "`--hint RA,DEC,ROLL,5`", "`--hint RA,DEC,ROLL,0.3`, or `--sequence`"
VECTORS = "simulated unit with an orbit: telemetry `matched_vectors`"
DOCUMENT = "always; with `--set acceptance=document` it rejects nothing"

DISPLACED_STAR = ChainStage("GSS: no displaced star", "chains.proof:displaced", "–", DOCUMENT)
NO_DISPLACED_STAR = replace(DISPLACED_STAR, reach="", left_out_by="--set acceptance=document")

STAGES: dict[str, tuple[ChainStage, ...]] = {
    "sunsat": (
        ChainStage("dark average of each row", "chains.sunsat_detect:dark_rows_dn", "Jacobs 1995 §2.2.1.2"),
        ChainStage("background above the dark average", "chains.sunsat_detect:zero_rows_dn", "§2.2.1.2, app. C.1"),
        ChainStage(
            "every third pixel, 4-connected growing, 10–300 px, edge rule",
            "chains.sunsat_detect:find_stars",
            "§2.2.1.2–3",
        ),
        ChainStage("shape: moments, elongation, direction", "chains.sunsat_detect:shapes", "§2.2.3, eq. 2.4–2.10"),
        ChainStage(
            "centre of gravity above threshold", "chains.sunsat_detect:gravity_centroids", "§2.2, eq. 2.1–2.2, app. C.1"
        ),
        ChainStage(
            "millimetres on the detector, tilt and radial polynomial",
            "gss.domain.camera:RadialTilt.undistort",
            "eq. 6.13–6.20",
        ),
        ChainStage("magnitude from area and illuminance", "chains.sunsat_detect:magnitudes", "eq. 2.12–2.13, app. C.1"),
        ChainStage(
            "match groups: magnitude, distance, ICLim, geometry split",
            "identify.match_groups:match_groups",
            "§3.3.5, app. D.2",
            LOST,
        ),
        ChainStage("mirror test", "identify.match_groups:mirrored", "§3.3.3"),
        ChainStage(
            "star vectors (Baldini)",
            "identify.star_vectors:match_star_vectors",
            "§3.2.2, app. D.1",
            "`--set matcher=star_vectors`",
        ),
        ChainStage("TRIAD on the widest pair", "chains.sunsat_match:widest_pair", "§4.1.6.1"),
        ChainStage(
            "roll, pitch, yaw",
            "chains.sunsat_frames:attitude_angles_rad",
            "§1.3–1.5, eq. 1.3–1.9",
            VECTORS,
            by_unit=True,
        ),
        ChainStage(
            "field on the sphere, with pole and RA = 0", "track.sphere_field:sphere_field", "§4.1.2, app. B", TRACKED
        ),
        ChainStage("nine boxes", "track.three_stars:by_boxes", "§4.1.4, Fig. 4-4", TRACKED),
        ChainStage(
            "expected stars and their windows", "chains.sunsat_track:expected_stars", "§4.1.2–4.1.4, §4.1.6.3", TRACKED
        ),
        ChainStage(
            "search in each window, always on the unchanged frame (the area is restored)",
            "chains.sunsat_track:find_in_windows",
            "§4.1.4.1",
            TRACKED,
        ),
        ChainStage(
            "three stars by distance; fourth to seventh star",
            "track.three_stars:ThreeStars",
            "§4.1.4.1, Tables 4-1, 4-2",
            TRACKED,
        ),
        ChainStage("predictor 2.5, −2, 0.5", "track.predictor:predict_attitude", "§4.1.8, app. E.2", "`--sequence`"),
        ChainStage(
            "radius of uncertainty from the ADCS or from TRIAD",
            "chains.sunsat_track:uncertainty_px",
            "§4.1.6, eq. 4.20",
            TRACKED,
        ),
        ChainStage(
            "a-priori attitude of the orbit",
            "chains.apriori:apriori_hint",
            "§1.3, §1.4",
            "simulated unit: `SET_ORBIT` and `SET_APRIORI`",
            by_unit=True,
        ),
        ChainStage(
            "matched star vectors for ADCS, aberration",
            "chains.sunsat_vectors:matched_vectors",
            "§3.4, §4.1.7, §7.5",
            VECTORS,
            by_unit=True,
        ),
        ChainStage(
            "GSS: false-match bound, test of the focal length",
            "chains.sunsat_bound:false_match_probability",
            "–",
            DOCUMENT,
        ),
        DISPLACED_STAR,
    ),
    "cubestar": (
        ChainStage(
            "plane search, region growing 6–60 px, at most 50 invalid", "regions:search", "Erlank 2013 §4.1.1–2, §5.3.3"
        ),
        ChainStage("5 x 5 centroid round the brightest pixel, at most 20", "centroid:window_centroids", "§4.1.3"),
        ChainStage(
            "Brown's K1 K2 P1 P2",
            "chains.cubestar_match:unit_vectors",
            "eq. 4.1.3–6",
            "`--set undistort=document` for inverted signs",
        ),
        ChainStage(
            "geometric voting, binary search of the distance table", "identify.geometric_voting:vote", "§4.3.3", LOST
        ),
        ChainStage("verification votes", "identify.geometric_voting:agreement", "§4.3.3"),
        ChainStage("assisted: catalogue within D_max", "identify.geometric_voting:reduced_table", "§4.3.4", NEAR),
        ChainStage("tracking within 0.3°", "track.nearest:match_nearest", "§4.5", TRACKED),
        ChainStage("states 2, 1, 0", "chains.modes:next_mode", "§5.3.4", "`--sequence`"),
        ChainStage("QUEST, votes as weights", "attitude:quest", "§4.4, eq. 4.4.9–10"),
        ChainStage(
            "GSS: false-match bound",
            "chains.cubestar:false_match_probability",
            "–",
            "`--set max_false_probability=1`",
        ),
        ChainStage(
            "GSS: handedness, focal length",
            "identify.focal_census:focal_objection",
            "–",
            left_out_by="--set acceptance=document",
        ),
        NO_DISPLACED_STAR,
        ChainStage(
            "GSS: residuals of three or four stars",
            "chains.proof:scattered",
            "–",
            left_out_by="--set acceptance=document",
        ),
    ),
    "far_mst": (
        ChainStage(
            "median dark",
            "calibration.dark:calibrate_dark",
            "Huffman 2006 §4.1",
            "`gss calibrate --darks`, or page *Calibration*",
            scene="dark",
        ),
        ChainStage("n·σ threshold, 8-connected clusters", "chains.far_mst_detect:clusters", "§4.1, §4.2.1"),
        ChainStage(
            "5 x 5 pre-filter, sliding or block",
            "chains.far_mst_detect:prefiltered",
            "§4.1, §4.2.2",
            "`--set prefilter=sliding`, `block`, `none`",
        ),
        ChainStage("weighted sum with aspect ratio", "chains.far_mst_centroid:weighted_sum", "§4.2.2"),
        ChainStage("maximum likelihood", "chains.far_mst_centroid:refine_mle", "eq. 4.3–4.8", "`--set centroider=mle`"),
        ChainStage("directory by sin²θ, k-vector", "gss.skytables.sin2:sin2_directory", "§5.5.4, eq. 6.6"),
        ChainStage(
            "n-vertex, 3, 4 and 5 stars",
            "identify.n_vertex:match_figure",
            "§5.5.4",
            "`--set matcher=n3`, `n4`, `n5`, `auto`",
        ),
        ChainStage("pyramid", "identify.triad_pyramid:pyramids", "§5.5.4", "`--set matcher=pyramid`"),
        ChainStage("tracking near predictions", "chains.far_mst_match:match_stars", "ch. 5, Fig. 8.2", TRACKED),
        ChainStage(
            "frame to frame: pair, triangle",
            "chains.far_mst_relative:relative_attitude",
            "§5.5, Fig. 8.2",
            "`--sequence`",
        ),
        ChainStage("frame to frame: rate match", "track.rate_match:rate_match", "§5.5.3, §8.1.2", "`--sequence`"),
        ChainStage(
            "relative attitude chaining",
            "chains.far_mst_relative:chained",
            "§7.2, eq. 7.1–7.2",
            "`--sequence --set min_identified=20,20,20`, for an image with fewer stars",
            scene="few",
        ),
        ChainStage("angular rate", "rates:rate_between", "§7.2", "`--sequence --interval S`"),
        ChainStage(
            "LIST: angular rate from stars without a catalogue",
            "chains.star_rates:rate_from_stars",
            "Table 1.3, §5.5",
            "`gss rate FILES --camera far_mst --interval S`; with `--set max_centroids=3 --set acceptance=document` three stars",
            scene="rate",
        ),
        ChainStage("selection of the matcher", "chains.far_mst_match:match_stars", "Fig. 8.2", "`--set matcher=auto`"),
        ChainStage("QUEST with covariance", "attitude:quest", "eq. 6.34"),
        ChainStage(
            "q-method, SVD, FOAM",
            "chains.far_mst:attitude_of",
            "eq. 6.21–6.24, 6.50, 6.54",
            "`--set attitude_method=q_method`, `svd`, `foam`",
        ),
        ChainStage(
            "GSS: false-match bound, share of identified stars",
            "chains.far_mst_verify:complete",
            "–",
            left_out_by="--set acceptance=document",
        ),
        NO_DISPLACED_STAR,
    ),
    "oersted": (
        ChainStage("threshold, brightness limit", "chains.oersted:find_centroids", "Liebe 1992, Magnitude-Uncertainty"),
        ChainStage(
            "window centroid (hyperaccuracy)", "hyperaccuracy:hyperaccurate_centroids", "Liebe 1992, Hyperaccuracy"
        ),
        ChainStage(
            "triplets: two nearest neighbours and their angle", "gss.skytables.triplets:features", "Initial Estimate"
        ),
        ChainStage(
            "quantised database with uncertainties of position and magnitude",
            "gss.skytables.triplets:build_triplets",
            "Inclusion of Position- and Magnitude-Uncertainty",
        ),
        ChainStage("vote among candidates", "identify.triplet_vote:vote", "Initial Estimate", LOST),
        ChainStage(
            "GSS: candidates one by one if the vote fails",
            "identify.triplet_alone:attitudes_of_triplet",
            "–",
            left_out_by="--set triplets_alone=0",
            scene="crowded",
        ),
        ChainStage(
            "predicted image, pairs by least distance, least squares",
            "track.predictional:predictional_fit",
            "Predictional Estimate",
            TRACKED,
        ),
        ChainStage(
            "differential correction", "track.differential:differential_attitude", "Predictional Estimate", TRACKED
        ),
        ChainStage(
            "averaging of successive estimates",
            "track.constant_rate:average_estimates",
            "Predictional Estimate",
            "`--sequence --set averaged=3`",
        ),
        ChainStage("assisted: triplets near the hint", "chains.oersted_match:match_stars", "– (GSS)", NEAR),
        ChainStage(
            "GSS: bound, residuals, focal length",
            "chains.oersted:false_match_probability",
            "–",
            DOCUMENT,
        ),
        DISPLACED_STAR,
    ),
    "aim": (
        ChainStage("coarse image and its mask", "coarse_mask:coarse_mask", "Moniteq 1983 §6.1, Fig. 6.1", LOST),
        ChainStage(
            "predicted windows, 4 x 4 or 3 x 3",
            "coarse_mask:windows_mask",
            "§3.8, Fig. 6.1",
            TRACKED + "; `--set window_px=4`",
        ),
        ChainStage("mean locator with dark mean", "mean_locator:mean_locations_px", "§4.1–4.3"),
        ChainStage("linear correction of the locator's bias", "mean_locator:bias_gain", "§4.2"),
        ChainStage("linked neighbour list, convex hull", "gss.skytables.neighbours:neighbour_links", "§6.1"),
        ChainStage("walk along the links", "track.link_walk:walk", "§6.1, Fig. 6.1", TRACKED),
        ChainStage("combinatorial blind search", "identify.neighbour_pattern:pair_hypotheses", "§6.1, Fig. 6.1", LOST),
        ChainStage("differential small-angle attitude, iterated", "track.differential:differential_attitude", "§6.2"),
        ChainStage(
            "guidance error: blind search of the same frame",
            "track.search_and_track:raises_guidance_error",
            "§6.1, Fig. 6.1",
            TRACKED,
        ),
        ChainStage(
            "two cameras",
            "track.cameras_together:body_attitude",
            "§6.2",
            "`gss experiments run moniteq-differential`",
            scene="experiment",
        ),
        ChainStage(
            "GSS: bound, residuals, handedness",
            "chains.aim:false_match_probability",
            "–",
            DOCUMENT,
        ),
        DISPLACED_STAR,
    ),
}
