"""False-match probability: the limit of the reference chain, and the observed share of false identifications."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np
from scipy.special import gammaincinv

from gss.domain.camera import Camera
from gss.domain.experiment import Cell, Curve, Experiment, Progress
from gss.domain.results import Centroids
from gss.domain.rotation import matrix_from_quaternion, random_quaternion
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains import reference
from gss.pipeline.chains.modes import Mode
from gss.pipeline.identify import near, pyramid
from gss.pipeline.identify.verify import field_of
from validation.never_wrong.faults import Fault, strangers
from validation.never_wrong.lists import CAMERAS, setting_of
from validation.never_wrong.sky import Setting, reference_hint, reference_sky

LIMITS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
DETECTIONS = (8, 16, 32)
SEARCHES = {"whole sky": Mode.LOST_IN_SPACE, "near an attitude": Mode.ASSISTED}
_STREAM = 911


def false_match(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Identify lists without a star, so that every identification is false. ``trials``: lists per camera and number of
    detections."""
    rows: list[tuple[Cell, ...]] = []
    pooled: dict[str, Counter[float]] = {search: Counter() for search in SEARCHES}
    cases = len(CAMERAS) * len(DETECTIONS)
    total, k = trials * cases, 0
    for name in CAMERAS:
        setting, camera = setting_of(name, reference.NAME), shipped_camera(name).camera
        sky = reference_sky(setting, shipped_camera(name), stars)
        for detections in DETECTIONS:
            accepted: dict[str, Counter[float]] = {search: Counter() for search in SEARCHES}
            for trial in range(trials):
                progress((k + trial / trials) / cases)
                rng = np.random.default_rng([seed, _STREAM, k, trial])
                centroids = _dots(detections, setting, camera, rng)
                for search, mode in SEARCHES.items():
                    accepted[search].update(_limits_passed(centroids, camera, sky, setting, mode, rng))
            for search, counts in accepted.items():
                pooled[search].update(counts)
                rows.append((name, detections, search, *(counts[limit] for limit in LIMITS)))
            k += 1
    for search, counts in pooled.items():
        rows.append(("all", "all", search, *(_with_interval(counts[limit], total * limit) for limit in LIMITS)))
    progress(1.0)
    return Experiment(
        "false-match",
        "False-match probability: limit and observed share",
        "requirement of GSS",
        ("camera", "detections", "search", *(f"false at a limit of {limit:g}" for limit in LIMITS)),
        tuple(rows),
        (
            f"{trials} lists per camera and number of detections, {total} in total; both searches get the same lists",
            "positions uniform over the detector, as the probability assumes; magnitudes uniform within 4 mag of the "
            "camera's limit; no star among them",
            "near an attitude: random attitudes with the radius of the camera's assisted mode in the never-wrong campaign",
            "rows of all cameras: number, 95 % interval, and limit times number of lists; a list that is identified at a "
            "limit is also counted at all higher ones",
        ),
        seed,
        (
            "A search accepts the first candidate whose false-match probability is at most the limit. The probability of a "
            "candidate is a bound for all candidates before it in one size of groups, so that the share of false "
            "identifications can exceed the limit by a factor of up to about ten per size (anchor_search.Trial).",
            f"The chain uses limits of {pyramid.ACCEPT:g} over the whole sky and {near.ACCEPT:g} near an attitude. The first "
            "is below the limits of this table, because its false identifications are too rare to count.",
            "Random points only. Mirrored lists and displaced stars, which caused most of the false attitudes of the "
            "never-wrong campaign, are tested there. Before an attitude is returned, the chain also tests the share of the "
            "matched stars, the focal length and the mirrored list.",
        ),
        tuple(
            Curve(
                f"All cameras, {search}",
                "limit of the false-match probability",
                "share of lists with a false identification",
                LIMITS,
                tuple(counts[limit] / total for limit in LIMITS),
            )
            for search, counts in pooled.items()
        ),
    )


def _with_interval(count: int, limit: float) -> str:
    """Format a count with its Poisson interval and the number that the limit allows."""
    low, high = (gammaincinv(count, 0.025) if count else 0.0), gammaincinv(count + 1, 0.975)
    return f"{count} ({low:.1f}–{high:.1f}); limit {limit:g}"


def _dots(detections: int, setting: Setting, camera: Camera, rng: np.random.Generator) -> Centroids:
    """Return a list of random points, brightest first."""
    pixels, v_mag = strangers(Fault("", false=detections), setting.seen_mag, camera, rng)
    order = np.argsort(v_mag)
    return Centroids.from_pixels(pixels[order], 10 ** (-0.4 * v_mag[order]), setting.noise_px)


def _limits_passed(
    centroids: Centroids,
    camera: Camera,
    sky: reference.KnownSky,
    setting: Setting,
    mode: Mode,
    rng: np.random.Generator,
) -> Iterator[float]:
    """Yield the limits at which the list is identified. A list that fails at one limit fails at all lower ones."""
    view = field_of(centroids, camera)
    attitude = None if mode is Mode.LOST_IN_SPACE else matrix_from_quaternion(random_quaternion(rng))
    hint = reference_hint(setting, mode, attitude)
    for limit in LIMITS:
        if hint is None:
            match = pyramid.identify_lost(view, sky.sky, sky.pairs, camera, accept=limit)
        else:
            match = near.identify_near(view, sky.sky, camera, hint, accept=limit)
        if match.evidence is None:
            return
        yield limit
