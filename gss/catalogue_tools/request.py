"""Parameters of one catalogue build, validated, and their conversion to plain values for the manifest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from gss.catalogue_tools.corrections.correction_switches import Corrections, corrections_of
from gss.catalogue_tools.envelope.attitude import AttitudeLimits
from gss.catalogue_tools.envelope.ellipse import check_ellipse
from gss.catalogue_tools.envelope.occultation import Occultation
from gss.catalogue_tools.envelope.orbits import Range, jyear_of
from gss.catalogue_tools.onboard import check_format
from gss.catalogue_tools.selection.screening import ScreeningRules
from gss.catalogue_tools.selection.selection import SelectionRules
from gss.catalogue_tools.sources.hipparcos import FAINTEST_V_MAG
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput, CorruptData
from gss.domain.json_object import JsonObject
from gss.skytables.bank import ReducedFrame


def own_format(camera: CameraProfile) -> str:
    """Return the on-board format of a camera's unit. Raises BadInput for a unit that cannot be loaded."""
    if not camera.formats:
        raise BadInput(
            "this instrument has no on-board catalogue format", expected="the name of a format", got=camera.name
        )
    return camera.formats[0]


PAIR_MIN_RAD = np.radians(0.25)
EPOCH_WITHOUT_DATES_JYEAR = 2000.0
# Maximum time in years between the epoch and the dates of use. In ten years, the fastest stars move by one pixel of a
# wide camera.
EPOCH_TOLERANCE_YR = 10.0
POINTINGS = 30_000
MAX_HEADS = 8
SOURCES = ("hipparcos", "hipparcos_all", "gaia", "list")
BLOCK_RULES = {"blocks": "centre", "whole_blocks": "whole"}
METHODS = ("exact", *BLOCK_RULES)


@dataclass(frozen=True)
class ElementsOrbit:
    """Limits of inclination and node, ICRS, for all arguments of latitude (Jacobs 1995 Table 5-2).

    If ``altitude_m`` is set, the node limits apply to the first day, and the Earth's oblateness moves them during the
    days of use (Moniteq 1983 §2.5). ``eccentricity`` above 0: eccentric orbit with the argument of perigee ``perigee_rad`` on
    the first day, which drifts too. It needs ``altitude_m``, the semi-major axis minus the Earth's equatorial radius.
    """

    inclination_rad: Range
    raan_rad: Range
    altitude_m: float | None = None
    eccentricity: float = 0.0
    perigee_rad: float = 0.0

    def __post_init__(self) -> None:
        if self.altitude_m is not None and not 100e3 <= self.altitude_m <= 1e9:
            raise BadInput(
                "altitude is out of range", expected="100 km to 1 000 000 km", got=f"{self.altitude_m / 1000:g} km"
            )
        if self.eccentricity and self.altitude_m is None:
            raise BadInput(
                "an eccentric orbit needs the altitude",
                expected="the semi-major axis minus 6378 km",
                got="no altitude",
                hint="set the altitude; it gives the drift of the perigee and the size of the Earth's disc",
            )
        if self.eccentricity and self.altitude_m is not None:
            check_ellipse(self.eccentricity, self.altitude_m)


@dataclass(frozen=True)
class TleOrbit:
    """A two-line element set; the node drifts from ``BuildRequest.start`` over its ``days``."""

    text: str


@dataclass(frozen=True)
class BuildRequest:
    """Parameters of one build. ``orbit`` None: no orbit. If ``attitude`` is also None, the envelope is the whole sky.

    ``margin_rad`` widens the field on every side. ``pair_max_rad`` None: the field's diagonal. ``start``: UTC with a
    time zone. ``epoch_jyear`` None: the middle of the validity, or J2000 without dates. ``bank_bytes`` None: the usual
    bank size of the format. ``query_tolerance_px``: half width of the matcher's distance query, for the quality report.
    ``source``: hipparcos, hipparcos_all, gaia, or list with ``star_list``. ``method``: exact, or blocks for the 1°
    steps of Jacobs 1995; whole_blocks marks only blocks that are completely in a field. ``k_vector``: also store an
    index of the distances on board. ``reduced``: frame of a reduced catalogue; the distances are then limited to
    its stars. None: no reduced catalogue, except for far-mst, which uses the camera's frame. ``heads``: mountings
    of several heads on the body, each as nine numbers of body_from_cam by rows. The envelope is then the union of
    the envelopes of all heads, and the mounting in ``attitude`` is not used.
    """

    profile: CameraProfile
    format_name: str
    rules: SelectionRules
    name: str = ""
    author: str = ""
    orbit: ElementsOrbit | TleOrbit | None = None
    attitude: AttitudeLimits | None = None
    start: datetime | None = None
    days: float = 14.0
    margin_rad: float = 0.0
    pair_min_rad: float = PAIR_MIN_RAD
    pair_max_rad: float | None = None
    epoch_jyear: float | None = None
    bank_bytes: int | None = None
    query_tolerance_px: float = 1.0
    seed: int = 1
    pointings: int = POINTINGS
    corrections: Corrections = field(default_factory=Corrections)
    source: str = "hipparcos"
    star_list: int | None = None
    occultation: Occultation = field(default_factory=Occultation)
    method: str = "exact"
    k_vector: bool = False
    reduced: ReducedFrame | None = None
    heads: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        check_format(self.format_name)
        if not (self.name.isprintable() and self.author.isprintable()):
            raise BadInput(
                "name or author of the catalogue contains control characters",
                expected="letters, digits and signs on one line",
                got=repr(f"{self.name} {self.author}")[:80],
            )
        if not 0 <= self.margin_rad < np.radians(30):
            raise BadInput("margin is out of range", expected="0° to 30°", got=f"{np.degrees(self.margin_rad):g}°")
        if not (np.isfinite(self.days) and 0 < self.days <= 3660):
            raise BadInput("validity is out of range", expected="more than 0, at most 3660 days", got=f"{self.days}")
        if self.start is not None and self.start.tzinfo is None:
            raise BadInput(
                "the start has no time zone", expected="a time with its offset from UTC", got=str(self.start)
            )
        if self.pointings < 1:
            raise BadInput(
                "the number of pointings for the quality is out of range",
                expected="at least 1",
                got=str(self.pointings),
            )
        if self.reduced is not None:
            _check_frame(self.reduced)
        _check_source(self)
        _check_epoch(self)
        _check_heads(self)

    @property
    def profile_name(self) -> str:
        """Name of the camera."""
        return self.profile.name

    @property
    def attitudes(self) -> tuple[AttitudeLimits | None, ...]:
        """Attitude limits of each head."""
        limits = self.attitude
        return tuple(replace(limits, body_from_cam=h) for h in self.heads) if self.heads and limits else (limits,)

    @property
    def depth_mag(self) -> float | None:
        """Magnitude limit for reading the source. None: all stars are read, because faint companions have an effect or
        corrections change magnitudes."""
        corrections = self.corrections
        deeper = (
            corrections.doubles is not None
            or corrections.instrument_magnitude
            or corrections.roll_off != "off"
            or corrections.variables_at_date
        )
        return None if deeper else self.rules.faint_mag

    @property
    def end(self) -> datetime | None:
        """End of the dates of use."""
        return self.start + timedelta(days=self.days) if self.start else None

    @property
    def middle(self) -> datetime | None:
        """Middle of the dates of use."""
        return self.start + timedelta(days=self.days / 2) if self.start else None


def epoch_of(request: BuildRequest) -> float:
    """Return the Julian year of the star positions."""
    if request.epoch_jyear is not None:
        return request.epoch_jyear
    return EPOCH_WITHOUT_DATES_JYEAR if request.middle is None else jyear_of(request.middle)


def parameters_of(request: BuildRequest) -> JsonObject:
    """Return the request as plain values for the manifest."""
    content: JsonObject = {"profile_name": request.profile_name}
    content |= {f.name: _plain(getattr(request, f.name)) for f in fields(request) if f.name != "profile"}
    content["start"] = request.start.isoformat() if request.start else None
    content["corrections"] = request.corrections.as_dict()
    return content


def _plain(value: Any) -> Any:
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value


def request_from(parameters: Mapping[str, Any], profile: CameraProfile) -> BuildRequest:
    """Return the request from the parameters of a manifest. ``profile``: the camera that the parameters name. Fields
    that were added after version 1 and are missing get their defaults. Raises CorruptData if the parameters are not
    valid."""
    field_names = {f.name for f in fields(BuildRequest)} - {"profile"}
    values = {name: value for name, value in parameters.items() if name in field_names}
    try:
        if parameters["profile_name"] != profile.name:
            raise ValueError(f"the camera is {parameters['profile_name']}, not {profile.name}")
        values["profile"] = profile
        values["rules"] = _rules_from(values["rules"])
        values["orbit"] = _orbit_from(values.get("orbit"))
        if values.get("attitude") is not None:
            values["attitude"] = AttitudeLimits(**{k: _pair(v) for k, v in values["attitude"].items()})
        if values.get("start"):
            values["start"] = datetime.fromisoformat(values["start"])
        values["heads"] = tuple(tuple(float(v) for v in head) for head in values.get("heads") or ())
        values["corrections"] = corrections_of(values.get("corrections") or {})
        values["occultation"] = Occultation(**(values.get("occultation") or {}))
        if values.get("reduced") is not None:
            values["reduced"] = ReducedFrame(**values["reduced"])
        return BuildRequest(**values)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise CorruptData(
            "the manifest's parameters are not a valid request", got=f"{type(error).__name__}: {error}"
        ) from None


def _rules_from(values: Mapping[str, Any]) -> SelectionRules:
    screening = values.get("screening")
    return SelectionRules(**{**values, "screening": None if screening is None else ScreeningRules(**screening)})


def _orbit_from(values: Mapping[str, Any] | None) -> ElementsOrbit | TleOrbit | None:
    if values is None:
        return None
    if "text" in values:
        return TleOrbit(str(values["text"]))
    limits = _pair(values["inclination_rad"]), _pair(values["raan_rad"])
    shape = float(values.get("eccentricity", 0.0)), float(values.get("perigee_rad", 0.0))
    return ElementsOrbit(*limits, values.get("altitude_m"), *shape)


def _pair(value: Any) -> Any:
    """Convert a list to a tuple, because JSON has no tuples."""
    return tuple(value) if isinstance(value, list) else value


def _check_frame(frame: ReducedFrame) -> None:
    sides = (frame.width_rad, frame.height_rad)
    possible = all(np.radians(1) <= side <= np.radians(120) for side in sides)
    if not (possible and 1 <= frame.brightest <= 100 and np.radians(0.25) <= frame.step_rad <= np.radians(10)):
        raise BadInput(
            "the frame of the reduced catalogue is out of range",
            expected="sides of 1° to 120°, 1 to 100 stars, steps of 0.25° to 10°",
            got=f"{np.degrees(sides[0]):g}° x {np.degrees(sides[1]):g}°, {frame.brightest} stars, "
            f"{np.degrees(frame.step_rad):g}°",
        )


def _check_source(request: BuildRequest) -> None:
    if request.source not in SOURCES:
        raise BadInput("unknown source of stars", expected=" | ".join(SOURCES), got=request.source)
    if request.method not in METHODS:
        raise BadInput("unknown method of the envelope", expected=" | ".join(METHODS), got=request.method)
    if request.source != "list" and request.star_list is not None:
        raise BadInput(
            "a star list was given, but the source does not use it", expected="source list", got=request.source
        )
    if request.source == "hipparcos" and request.rules.faint_mag > FAINTEST_V_MAG:
        raise BadInput(
            "the star table does not reach this magnitude limit",
            expected=f"V ≤ {FAINTEST_V_MAG:g}",
            got=f"{request.rules.faint_mag:g}",
            hint="use the source hipparcos_all or gaia for fainter cameras",
        )


def _check_heads(request: BuildRequest) -> None:
    """Raise BadInput if several heads are combined with an option that is defined for a single camera only."""
    if not request.heads:
        return
    limits = request.attitude
    single = {
        "no limits of attitude": limits is None,
        "another mounting": limits is not None and limits.body_from_cam is not None,
        "the method blocks": request.method in BLOCK_RULES,
        "occultation": request.occultation.active,
    }
    conflicting = ", ".join(option for option, has in single.items() if has)
    if conflicting:
        raise BadInput(
            "a catalogue for several heads cannot be built with these options",
            expected="limits of attitude, the exact method, and no occultation",
            got=conflicting,
        )
    if len(request.heads) > MAX_HEADS:
        raise BadInput("too many heads", expected=f"at most {MAX_HEADS}", got=str(len(request.heads)))
    _ = request.attitudes  # reading the property checks each mounting


def _check_epoch(request: BuildRequest) -> None:
    if request.middle is None or request.epoch_jyear is None:
        return
    if not abs(request.epoch_jyear - jyear_of(request.middle)) <= EPOCH_TOLERANCE_YR:
        raise BadInput(
            "the epoch of the positions is far from the dates of use",
            expected=f"within {EPOCH_TOLERANCE_YR:g} years of {jyear_of(request.middle):.1f}",
            got=f"{request.epoch_jyear:g}",
        )
