"""Inputs of the never-wrong campaign: each chain's camera and bank, and simulated centroid lists."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gss.domain.angles import Array, lengths
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.results import Centroids, Outcome, SolveResult, Truth
from gss.domain.rotation import quaternion_from_matrix, rotation_from_vector
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains import reference
from gss.pipeline.chains.aim_parameters import default_parameters as aim_parameters
from gss.pipeline.chains.modes import AttitudePrior, Mode
from gss.pipeline.chains.onboard import Commanded, Work
from gss.pipeline.chains.sunsat_detect import brightness_dn
from gss.pipeline.chains.sunsat_parameters import default_parameters as sunsat_parameters
from gss.pipeline.chains.systems import system
from gss.pipeline.identify import near
from gss.pipeline.identify.verify import SkyCatalogue
from gss.pipeline.render import stars_near, truth_of
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.pairs import distance_table
from validation.never_wrong.faults import Fault, displace, fade, strangers

Solver = Callable[[Centroids, Mode, Array | None], SolveResult]
"""Solver of centroids in a mode, with a prior attitude except when lost in space. In assisted mode a system's chain
receives only the boresight of the prior."""
REFERENCE_CAMERA = "far_mst"
# Camera whose frames each chain receives for the fault ``another``.
OTHER_CAMERA = {"cubestar": "far_mst", "far_mst": "oersted", "oersted": "sunsat", "sunsat": "oersted", "aim": "sunsat"}
# Range of magnitudes beyond the limit in which noise can make a star brighter than the limit.
BEYOND_MAG = 1.5


@dataclass(frozen=True)
class Setting:
    """Test settings of one chain: magnitude limit of its bank, faintest star that it measures, errors of position and
    brightness, errors of the prior in assisted mode and in tracking. ``share``: share of the trials, for a slow
    chain."""

    chain: str
    camera: str
    bank_mag: float
    seen_mag: float
    noise_px: float
    noise_mag: float
    assisted_rad: float
    tracking_rad: float
    share: float = 1.0


def _deg(value: float) -> float:
    return float(np.radians(value))


SETTINGS = (
    Setting("cubestar", "cubestar", 3.8, 3.8, 0.2, 0.1, _deg(5), _deg(0.25)),
    Setting("sunsat", "sunsat", 6.0, 6.0, 0.2, 0.2, _deg(2), _deg(0.3)),
    Setting("far_mst", "far_mst", 5.2, 5.2, 0.2, 0.1, _deg(5), _deg(0.3)),
    Setting("oersted", "oersted", 5.6, 5.2, 0.2, 0.08, _deg(4), _deg(0.25)),
    Setting("aim", "aim", 7.5, 7.5, 0.05, 0.05, _deg(4), _deg(0.25)),
    Setting("reference", REFERENCE_CAMERA, 5.2, 5.2, 0.2, 0.1, _deg(5), _deg(0.3), 0.25),
)


@dataclass(frozen=True)
class Subject:
    """A chain with its camera and star table, ready to solve."""

    setting: Setting
    profile: CameraProfile
    stars: StarTable
    solve: Solver

    @property
    def camera(self) -> Camera:
        """The camera that the chain assumes."""
        return self.profile.camera


def subject(setting: Setting, stars: StarTable) -> Subject:
    """Build the chain with its camera and a bank over the whole sky."""
    profile = shipped_camera(setting.camera)
    solve = _reference(setting, profile, stars) if setting.chain == reference.NAME else _system(setting, profile, stars)
    return Subject(setting, profile, stars.brighter_than(setting.seen_mag + BEYOND_MAG), solve)


def _system(setting: Setting, profile: CameraProfile, stars: StarTable) -> Solver:
    chain, works = system(setting.chain), works_of(setting, profile, stars)

    def solve(centroids: Centroids, mode: Mode, near_icrs: Array | None) -> SolveResult:
        work = replace(works[mode], hint=None if near_icrs is None else hint_of(mode, near_icrs))
        s = chain.calculate_attitude(chain.match_stars(centroids, work), centroids, work)
        outcome = Outcome.SOLVED if s.attitude is not None else Outcome.NONE
        probability = s.false_match_probability
        return SolveResult(
            chain.name, outcome, s.reason, profile.camera, (), centroids, s.matches, s.attitude, probability
        )

    return solve


def works_of(setting: Setting, profile: CameraProfile, stars: StarTable) -> dict[Mode, Work]:
    """Return a system's ``Work`` for each mode, without a hint, with a bank over the whole sky."""
    chain = system(setting.chain)
    catalogue = chain.prepare(_bank(stars.brighter_than(setting.bank_mag), profile.camera), profile)
    return {m: Work(profile.camera, catalogue, chain.parameters(profile, None, Commanded(), m), m) for m in Mode}


def _bank(bright: StarTable, camera: Camera) -> OnboardCatalogue:
    """Return a bank over the whole sky, in a device's number formats."""
    table = distance_table(bright, 0.0, camera.diagonal_rad).single_precision()
    return OnboardCatalogue(bright.hip, bright.icrs.astype(np.float32), bright.v_mag.astype(np.float32), table)


def _reference(setting: Setting, profile: CameraProfile, stars: StarTable) -> Solver:
    sky = reference_sky(setting, profile, stars)

    def solve(centroids: Centroids, mode: Mode, near_icrs: Array | None) -> SolveResult:
        return reference.solve_centroids(centroids, profile.camera, sky, hint=reference_hint(setting, mode, near_icrs))

    return solve


def reference_sky(setting: Setting, profile: CameraProfile, stars: StarTable) -> reference.KnownSky:
    """Return the sky of the reference chain. It contains the whole table, but identification uses only the stars in the
    bank."""
    return reference.known_sky(SkyCatalogue(stars.hip, stars.icrs, stars.v_mag), profile.camera, setting.bank_mag)


def reference_hint(setting: Setting, mode: Mode, near_icrs: Array | None) -> near.BoundedPrior | None:
    """Return the prior in the form of the reference chain."""
    radius_rad = setting.tracking_rad if mode is Mode.TRACKING else setting.assisted_rad
    return None if near_icrs is None else near.BoundedPrior(near_icrs, radius_rad)


def hint_of(mode: Mode, near_icrs: Array) -> AttitudePrior:
    """Return the prior in the form of a system's chain: the full attitude in tracking mode, otherwise the boresight."""
    if mode is Mode.TRACKING:
        return AttitudePrior.from_quaternion(quaternion_from_matrix(near_icrs))
    return AttitudePrior(near_icrs[2])


def prior(setting: Setting, mode: Mode, attitude: Array, rng: np.random.Generator) -> Array | None:
    """Return an attitude that differs from the true attitude by up to the setting's angle about any axis; None in
    lost-in-space mode."""
    if mode is Mode.LOST_IN_SPACE:
        return None
    axis = rng.normal(size=3)
    largest_rad = setting.tracking_rad if mode is Mode.TRACKING else setting.assisted_rad
    return np.asarray(rotation_from_vector(axis / np.linalg.norm(axis) * largest_rad * rng.random()) @ attitude)


@dataclass(frozen=True)
class Shown:
    """A centroid list, brightest first, the truth, and the (n, 2) positions of the stars' light, which a fault can displace."""

    centroids: Centroids
    truth: Truth
    light_px: Array

    def truth_for(self, result: SolveResult) -> Truth:
        """Return the truth with which to compare a result. A star is at its light or, if this is nearer to the matched
        centroid, at its place: two stars at one place, such as α Centauri A and B, can exchange their names."""
        pixels = self.light_px.copy()
        if result.matches is not None:
            _, star, match = np.intersect1d(self.truth.hip, result.matches.hip, return_indices=True)
            measured, place = self.centroids.pixels[result.matches.centroid[match]], self.truth.pixels[star]
            nearer = lengths(place - measured) < lengths(pixels[star] - measured)
            pixels[star[nearer]] = place[nearer]
        return replace(self.truth, pixels=pixels)


def shown(subject: Subject, fault: Fault, attitude: Array, rng: np.random.Generator) -> Shown:
    """Simulate the camera's centroid list at an attitude with a fault. The list contains every star measured brighter
    than the limit, including stars that are not in the bank."""
    setting, believed = subject.setting, subject.camera
    true = shipped_camera(OTHER_CAMERA[setting.camera]).camera if fault.another else believed
    if fault.scale != 1:
        true = replace(true, focal_col_px=fault.scale * true.focal_col_px, focal_row_px=fault.scale * true.focal_row_px)
    truth = truth_of(stars_near(subject.stars, true, attitude), true, attitude)
    n = len(truth.hip)
    v_mag = truth.v_mag + setting.noise_mag * rng.normal(size=n) + fault.off_mag * rng.choice((-1.0, 1.0), n)
    v_mag = fade(v_mag + fault.shift_mag, fault, rng)
    seen = (v_mag <= setting.seen_mag) & (rng.random(n) >= fault.missing) & believed.contains(truth.pixels)
    pixels = truth.pixels[seen] + setting.noise_px * rng.normal(size=(int(seen.sum()), 2))
    displaced, v_mag = displace(pixels, v_mag[seen], setting.seen_mag, fault, rng)
    light = truth.pixels.copy()
    light[seen] += displaced - pixels
    more_pixels, more_mag = strangers(fault, setting.seen_mag, believed, rng)
    pixels, v_mag = np.vstack([displaced, more_pixels]), np.concatenate([v_mag, more_mag])
    if fault.mirrored:
        pixels[:, 0] = believed.columns - 1 - pixels[:, 0]
    order = np.argsort(v_mag, kind="stable")
    flux = _flux_dn(setting, subject.profile, v_mag[order])
    return Shown(Centroids.from_pixels(pixels[order], flux, setting.noise_px), truth, light)


def _flux_dn(setting: Setting, profile: CameraProfile, v_mag: Array) -> Array:
    """Return fluxes on the scale from which the chain computes magnitudes. For chains that only compare brightness, the
    scale has no effect."""
    if setting.chain == "sunsat":
        return brightness_dn(v_mag, sunsat_parameters(profile))
    if setting.chain == "aim":
        p = aim_parameters(profile)
        return np.asarray(p.dn_at_mag_0 * p.light_share * 10 ** (-0.4 * v_mag))
    return np.asarray(10 ** (-0.4 * v_mag))
