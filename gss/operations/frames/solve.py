"""Solution of a frame with any chain, for the command line and the server."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.sources.hipparcos import FAINTEST_V_MAG
from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput, NotFound
from gss.domain.results import BLIND, SolveResult
from gss.domain.rotation import quaternion_from_matrix
from gss.domain.stars import StarTable
from gss.operations.clock import Monotonic
from gss.operations.frames.dark_frames import DARK, Pattern
from gss.operations.frames.solver_cache import SolverCache
from gss.pipeline.chains import reference
from gss.pipeline.chains.modes import AttitudePrior, Mode
from gss.pipeline.chains.onboard import Commanded, OnboardChain, Work, solve
from gss.pipeline.chains.options import ChainOption, as_text, listed, with_options
from gss.pipeline.chains.reference_foreign import solve_foreign
from gss.pipeline.chains.systems import CONSTANT_SOURCES, SYSTEMS, system
from gss.pipeline.fixed_pattern import clean
from gss.pipeline.identify import near

if TYPE_CHECKING:
    from gss.operations.frames.observer import Observer

CHAINS = (reference.NAME, *SYSTEMS)
TRACKING_RADIUS_RAD = float(np.radians(0.3))
"""Maximum uncertainty of a hint for tracking mode (Erlank 2013 §4.5)."""
BLIND_FOV_RAD = (float(np.radians(4.0)), float(np.radians(60.0)))
FOV_SLACK = 1.08
"""Margin for a field of view that is "known to 5 %", measured as an angle on the sky or as pixels × scale."""
DEFAULT_EPOCH_JYEAR = 2026.5
USUAL_PER_FRAME, MAX_PER_FRAME = 25, 100
"""Number of stars per average frame for identification: assumed number for a camera without photometry, and maximum.
More stars would make identification slower but not more reliable. Fainter stars are matched after the attitude is
known."""
MAX_PAIRS = 2_000_000
"""Approximate maximum size of a pair table. Building a larger table takes minutes."""
DEEPER_MAG = 1.0
"""Additional depth, in magnitudes, of a second catalogue. It is used if a frame shows more stars than the first
catalogue contains."""


@dataclass(frozen=True)
class Started:
    """Initial state of a system's chain for a frame: mode, prior attitude, and its uncertainty."""

    mode: Mode
    hint: AttitudePrior | None
    radius_rad: float | None = None


@dataclass(frozen=True)
class SolveRequest:
    """Request to solve a frame. Exactly one of these fields specifies the camera: ``profile`` (a name), ``camera_profile`` (a
    complete camera, for example a calibrated one), ``camera`` (geometry only), ``fov_rad`` (horizontal field of view, known to
    about 5 %), or ``blind``.

    ``fov_limits_rad``: range of horizontal fields of view of a blind solve; None: 4° to 60°. ``hint``: prior attitude, for a known
    camera. ``epoch_jyear``: epoch of the star positions; None: default of the solver. ``observer``: velocity of the observer when
    the frame was taken; None: aberration is not corrected. ``exposure_s``: exposure, needed for the rate of trailed frames.
    ``fast``: True for compiled loops, False for loops without compilation; None: compiled loops if they are compiled. The
    chains of the systems always use the latter.
    ``options``: changed constants of a system's chain, as (name, text). ``started``: mode and prior knowledge of a system's
    chain, instead of ``hint``.
    """

    chain: str = reference.NAME
    profile: str | None = None
    camera_profile: CameraProfile | None = None
    camera: Camera | None = None
    fov_rad: float | None = None
    blind: bool = False
    fov_limits_rad: tuple[float, float] | None = None
    hint: near.BoundedPrior | None = None
    epoch_jyear: float | None = None
    observer: Observer | None = None
    exposure_s: float | None = None
    fast: bool | None = None
    options: tuple[tuple[str, str], ...] = ()
    started: Started | None = None

    @property
    def camera_name(self) -> str:
        """Camera name that is stored with solutions: name of the profile, "field of view", "geometry" or "blind"."""
        if self.profile is not None:
            return self.profile
        if self.camera_profile is not None:
            return self.camera_profile.name
        return "geometry" if self.camera else "field of view" if self.fov_rad is not None else BLIND


class Solver:
    """Runs solve requests. ``profiles``: returns the camera with a name. ``stopwatch_s``: clock that times the stages; it does not
    affect results. ``dark``: returns the dark frame with a key."""

    def __init__(
        self,
        profiles: Callable[[str], CameraProfile],
        cache: SolverCache | None = None,
        stopwatch_s: Monotonic | None = None,
        epoch_jyear: float = DEFAULT_EPOCH_JYEAR,
        dark: Pattern | None = None,
    ) -> None:
        self.cache = cache if cache is not None else SolverCache()
        self._stopwatch_s, self._epoch_jyear, self._profiles = stopwatch_s, epoch_jyear, profiles
        self._dark = dark

    def solve(self, pixels: NDArray[Any], request: SolveRequest) -> SolveResult:
        """Solve one (rows, columns) frame, or complete rows with the dark columns of the camera. A frame without a solution
        returns a result with outcome NONE. An invalid request raises BadInput or NotFound."""
        if request.chain not in CHAINS:
            raise NotFound("unknown chain", expected=" | ".join(CHAINS), got=request.chain)
        profile, camera = _camera_of(request, self._profiles)
        epoch = self._epoch_of(request.epoch_jyear)
        if request.options and request.chain == reference.NAME:
            raise _no_constants()
        if request.chain != reference.NAME:
            return self._system(pixels, profile, request, epoch)
        if camera is None:
            result = self._foreign(pixels, request, epoch)
        else:
            sensor = profile.sensor if profile else None
            limit = min(sensor.faint_limit_mag, _deepest(camera)) if sensor else _usual_limit(camera)
            stars = self.cache.known(camera, limit, epoch)
            pixels, cleaned = self.cleaned(pixels, profile, request.exposure_s)
            fainter = min(limit + DEEPER_MAG, FAINTEST_V_MAG)
            result = reference.solve_known(
                pixels,
                camera,
                sensor,
                stars,
                hint=request.hint,
                deeper=lambda: self.cache.known(camera, fainter, epoch),
                velocity_c=_velocity_c(request),
                exposure_s=request.exposure_s,
                fast=request.fast,
                clock=self._stopwatch_s,
            )
            result = replace(result, notes=(*result.notes, *cleaned))
        return _noted(_with_aberration_note(result, request.observer), profile, epoch)

    def stars(self, epoch_jyear: float | None) -> StarTable:
        """Return the star positions that a request with this epoch uses."""
        return self.cache.stars(self._epoch_of(epoch_jyear))

    def _epoch_of(self, epoch_jyear: float | None) -> float:
        return self._epoch_jyear if epoch_jyear is None else epoch_jyear

    def cleaned(
        self, pixels: NDArray[Any], profile: CameraProfile | None, exposure_s: float | None
    ) -> tuple[NDArray[Any], tuple[str, ...]]:
        """Subtract the dark frame if one is active. Return the light-sensitive pixels and notes that describe the correction.
        Chains that emulate a sensor use the uncorrected pixels."""
        if profile is not None:
            pixels, _ = profile.sensor.dark_columns.split(pixels, profile.camera.columns)
        key = profile.sources.get(DARK, "") if profile else ""
        if profile is None or not key or self._dark is None:
            return pixels, ()
        dark = self._dark(key)
        replaced = f"{len(dark.bad)} bad pixels replaced by their neighbours"
        note = f"dark frame subtracted, {replaced}"
        if not dark.pattern_dn.any():
            note = replaced
        elif not dark.fits(exposure_s):
            note = f"{replaced}; the dark frame has an exposure of {dark.exposure_s:g} s and was not subtracted"
        return clean(pixels, dark, float(profile.sensor.saturation_dn), exposure_s), (note,)

    def _foreign(self, pixels: NDArray[Any], request: SolveRequest, epoch_jyear: float) -> SolveResult:
        limits = request.fov_limits_rad or BLIND_FOV_RAD
        if request.fov_rad is not None:
            limits = (request.fov_rad / FOV_SLACK, request.fov_rad * FOV_SLACK)
        sky = self.cache.sky(epoch_jyear)
        return solve_foreign(
            pixels,
            limits,
            sky,
            self.cache.level(epoch_jyear),
            velocity_c=_velocity_c(request),
            exposure_s=request.exposure_s,
            fast=request.fast,
            clock=self._stopwatch_s,
        )

    def parameters(self, request: SolveRequest) -> Any:
        """Return the constants with which a system's chain would run a request. Raises BadInput if the request has no camera
        profile."""
        profile, _ = _camera_of(request, self._profiles)
        if profile is None:
            raise BadInput("constants of a system need its camera", expected="a camera profile")
        return _parameters(system(request.chain), profile, request.started or _started(request.hint), request.options)

    def _system(
        self, pixels: NDArray[Any], profile: CameraProfile | None, request: SolveRequest, epoch_jyear: float
    ) -> SolveResult:
        """Run the chain of a sensor with a bank like the one in its flash. Raises BadInput if the request has no camera
        profile."""
        if profile is None:
            raise BadInput(
                f"the {request.chain} chain needs a calibrated camera",
                expected="a camera profile",
                got="a field of view or nothing",
                hint="choose a profile, or use the reference chain",
            )
        chain, started = system(request.chain), request.started or _started(request.hint)
        prepared = self.cache.prepared(chain, profile, epoch_jyear)
        parameters = _parameters(chain, profile, started, request.options)
        pixels, dark = profile.sensor.dark_columns.split(pixels, profile.camera.columns)
        work = Work(profile.camera, prepared, parameters, started.mode, started.hint, dark)
        result = solve(chain, pixels, work, self._stopwatch_s)
        return replace(_noted(result, profile, epoch_jyear), options=as_text(dict(request.options)))


def warm_up_image(profile: CameraProfile) -> NDArray[np.unsignedinteger[Any]]:
    """Return an image of a camera with twelve random trails. A chain that solves it with its exposure loads its loops."""
    rows, columns = profile.camera.rows, profile.camera.columns
    places = np.random.default_rng(1).integers(5, [columns - 5, rows - 5], (12, 2))
    pixels = np.random.default_rng(2).integers(8, 14, (rows, columns))
    for col, row in places:
        pixels[row - 1 : row + 2, col - 4 : col + 5] += np.array([[30], [90], [30]])
    return pixels.astype(np.uint8 if profile.sensor.bits <= 8 else np.uint16)


def options_of(chain: str, profile: CameraProfile, changed: Mapping[str, str] | None = None) -> tuple[ChainOption, ...]:
    """Return the constants of a chain for a camera in lost-in-space mode. The reference chain has none. ``changed``: changed
    constants. Raises NotFound for an unknown chain, BadInput for a change that the chain rejects."""
    if chain == reference.NAME:
        if changed:
            raise _no_constants()
        return ()
    parameters = _parameters(system(chain), profile, Started(Mode.LOST_IN_SPACE, None), tuple((changed or {}).items()))
    return listed(parameters, CONSTANT_SOURCES[chain])


def _no_constants() -> BadInput:
    return BadInput("the reference chain has no constants to set", expected=" | ".join(SYSTEMS), got=reference.NAME)


def _started(hint: near.BoundedPrior | None) -> Started:
    """Return the initial state of a system's chain for a hint: tracking mode for an accurate hint, otherwise assisted mode."""
    if hint is None:
        return Started(Mode.LOST_IN_SPACE, None)
    mode = Mode.TRACKING if hint.radius_rad <= TRACKING_RADIUS_RAD else Mode.ASSISTED
    return Started(mode, AttitudePrior.from_quaternion(quaternion_from_matrix(hint.cam_from_icrs)), hint.radius_rad)


def _parameters(
    chain: OnboardChain, profile: CameraProfile, started: Started, options: tuple[tuple[str, str], ...]
) -> Any:
    defaults = chain.parameters(profile, None, Commanded(hint_radius_rad=started.radius_rad), started.mode)
    return with_options(defaults, dict(options))


def _velocity_c(request: SolveRequest) -> Array | None:
    return None if request.observer is None else np.array(request.observer.velocity_c)


def _with_aberration_note(result: SolveResult, observer: Observer | None) -> SolveResult:
    """Add a note that states whether aberration was corrected."""
    if result.attitude is None:
        return result
    note = "aberration was not corrected" if observer is None else observer.note
    return replace(result, notes=(*result.notes, note))


def _camera_of(
    request: SolveRequest, profiles: Callable[[str], CameraProfile]
) -> tuple[CameraProfile | None, Camera | None]:
    """Return the requested profile and geometry. Both are None for an unknown camera. Raises BadInput."""
    specified = [
        name
        for name, stated in (
            ("profile", request.profile is not None),
            ("whole camera", request.camera_profile is not None),
            ("camera", request.camera is not None),
            ("field of view", request.fov_rad is not None),
            ("blind", request.blind),
        )
        if stated
    ]
    if len(specified) != 1:
        raise BadInput(
            "the camera must be given in exactly one way",
            expected="a profile, a geometry, a field of view, or blind",
            got=" and ".join(specified) or "none of them",
        )
    if request.fov_rad is not None and not np.radians(0.5) <= request.fov_rad <= np.radians(120):
        raise BadInput(
            "field of view is out of range", expected="0.5° to 120°", got=f"{np.degrees(request.fov_rad):g}°"
        )
    profile = request.camera_profile if request.profile is None else profiles(request.profile)
    if profile is not None:
        return profile, profile.camera
    return None, request.camera


def _noted(result: SolveResult, profile: CameraProfile | None, epoch_jyear: float) -> SolveResult:
    """Add notes on the epoch of the star positions and, for a calibrated camera, on the calibration."""
    version = profile.sources.get("calibration", "") if profile else ""
    notes = (f"star positions of {epoch_jyear:.2f}", *((f"camera: {version}",) if version else ()))
    return replace(result, notes=(*result.notes, *notes))


def _usual_limit(camera: Camera) -> float:
    """Return the assumed magnitude limit of a camera without photometry."""
    return float(np.clip(_limit_for(camera, USUAL_PER_FRAME), 2.5, 8.0))


def _deepest(camera: Camera) -> float:
    """Return the magnitude limit above which additional stars only make the search slower."""
    # Each star of the sky has pairs with about four times the number of stars that fall on the detector.
    return _limit_for(camera, min(MAX_PER_FRAME, float(np.sqrt(MAX_PAIRS / 2 * _share_of_sky(camera)))))


def _limit_for(camera: Camera, stars: float) -> float:
    """Return the magnitude limit with which about this number of stars falls on the detector."""
    # Hipparcos contains about 4900 stars to V 6 and 2.9 times as many for each further magnitude.
    return float(6 + np.log(stars / (4900 * _share_of_sky(camera))) / np.log(2.9))


def _share_of_sky(camera: Camera) -> float:
    return camera.columns * camera.rows * camera.pixel_rad**2 / (4 * np.pi)
