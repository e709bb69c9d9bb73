"""Assign the columns of a user's star list to fields and units, by the usual names or as the user specifies."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from gss.catalogue_tools.sources.star_list_guards import check_unit
from gss.domain.angles import ARCSEC_RAD
from gss.domain.errors import BadInput

KINDS = ("csv", "ecsv", "fits", "votable")
LIST_FRAMES = ("icrs", "fk5", "b1950")
BAD_ROWS = ("drop", "refuse")
FIELDS = ("id", "ra", "dec", "v", "b_v", "pm_ra", "pm_dec", "parallax", "name", "flags")
REQUIRED = ("ra", "dec", "v")
# Usual names by field, ignoring case, blanks, underscores, dots and brackets. The first name present in a file is used.
USUAL_NAMES: dict[str, tuple[str, ...]] = {
    name: tuple(words.split())
    for name, words in {
        "id": "hip hipid hipnumber id starid number no nr hr hd sao sourceid",
        "ra": "ra raicrs raj2000 radeg rarad rahours ra2000 alpha rightascension raj1950 rab1950",
        "dec": "dec de deicrs dej2000 dedeg decdeg decrad derad dec2000 delta declination dej1950 deb1950",
        "v": "v vmag vm mag magnitude mv johnsonv physmagv hpmag hp gmag photgmeanmag",
        "b_v": "bv bminusv colour color colourindex colorindex",
        "pm_ra": "pmra pmracosdec mura mualpha mualphastar propermotionra",
        "pm_dec": "pmdec pmde mudec mudelta propermotiondec",
        "parallax": "parallax plx",
        "name": "name proper propername starname bayer designation mainid",
        "flags": "gssflags",
    }.items()
}
DEGREE_RAD = float(np.pi / 180)
# Factors to internal units. "sexagesimal" is read as text: hours for a right ascension, degrees for a declination.
ANGLE_UNITS = {
    "deg": DEGREE_RAD,
    "rad": 1.0,
    "hourangle": 15 * DEGREE_RAD,
    "arcmin": DEGREE_RAD / 60,
    "arcsec": ARCSEC_RAD,
    "mas": ARCSEC_RAD / 1000,
}
MOTION_UNITS = {
    f"{angle}/{time}": factor / years
    for angle, factor in ANGLE_UNITS.items()
    for time, years in (("yr", 1.0), ("century", 100.0))
}
SEXAGESIMAL = "sexagesimal"
UNITS_OF = {
    "ra": (*ANGLE_UNITS, SEXAGESIMAL),
    "dec": (*ANGLE_UNITS, SEXAGESIMAL),
    "parallax": tuple(ANGLE_UNITS),
    "pm_ra": tuple(MOTION_UNITS),
    "pm_dec": tuple(MOTION_UNITS),
    "v": ("mag",),
    "b_v": ("mag",),
}
# Default units if a file states none: degrees and milliarcseconds, as in the lists of Hipparcos and Gaia.
USUAL_UNITS = {
    "ra": "deg",
    "dec": "deg",
    "parallax": "mas",
    "pm_ra": "mas/yr",
    "pm_dec": "mas/yr",
    "v": "mag",
    "b_v": "mag",
}
SPELLINGS = {
    "degree": "deg", "degrees": "deg", "d": "deg", "radian": "rad", "radians": "rad", "h": "hourangle", "hour": "hourangle",
    "hours": "hourangle", "hms": SEXAGESIMAL, "dms": SEXAGESIMAL, "arcseconds": "arcsec", "milliarcsec": "mas",
    '"h:m:s"': SEXAGESIMAL, '"d:m:s"': SEXAGESIMAL, "h:m:s": SEXAGESIMAL, "d:m:s": SEXAGESIMAL, "magnitude": "mag",
}  # fmt: skip
TIMES = {"a": "yr", "y": "yr", "year": "yr", "yr": "yr", "cy": "century", "century": "century", "ha": "century"}


@dataclass(frozen=True)
class ListMapping:
    """Settings for reading a star list. A setting can be omitted if the file states it.

    ``columns``: columns of the file by field (FIELDS). ``units``: units by field. ``epoch_jyear``: Julian year of the
    positions, required if the file does not state one. ``frame``: one of LIST_FRAMES; "fk5" is J2000, "b1950" is the
    FK4 with E-terms. ``pm_ra_has_cos_dec``: True if the motion in right ascension includes cos δ. ``bad_rows``: drop
    invalid rows with a report, or refuse the list.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    epoch_jyear: float | None = None
    frame: str | None = None
    pm_ra_has_cos_dec: bool = True
    bad_rows: str = "drop"

    def __post_init__(self) -> None:
        self._check_types()
        for name, allowed in (("columns", FIELDS), ("units", tuple(UNITS_OF))):
            if unknown := set(getattr(self, name)) - set(allowed):
                raise BadInput(
                    f"unknown field in the {name}", expected=" | ".join(allowed), got=", ".join(sorted(unknown))
                )
        for name, unit in self.units.items():
            plain_unit(name, unit)
        if self.frame is not None and self.frame not in LIST_FRAMES:
            raise BadInput("unknown frame of a star list", expected=" | ".join(LIST_FRAMES), got=str(self.frame))
        if self.bad_rows not in BAD_ROWS:
            raise BadInput("unknown treatment of invalid rows", expected=" | ".join(BAD_ROWS), got=str(self.bad_rows))

    def _check_types(self) -> None:
        """Raise BadInput for values of a wrong type, which JSON can contain. For example, the text "no" must not be
        read as true."""
        for name in ("columns", "units"):
            fields = getattr(self, name)
            if not isinstance(fields, Mapping) or not all(isinstance(t, str) for pair in fields.items() for t in pair):
                raise BadInput(
                    f"{name} of a star list is not understood", expected="a word for each field", got=_short(fields)
                )
        epoch: object = self.epoch_jyear
        if epoch is not None and (isinstance(epoch, bool) or not isinstance(epoch, int | float)):
            raise BadInput("epoch_jyear of a star list is not understood", expected="a number", got=_short(epoch))
        has_cos_dec: object = self.pm_ra_has_cos_dec
        if not isinstance(has_cos_dec, bool):
            got = _short(has_cos_dec)
            raise BadInput("pm_ra_has_cos_dec is not understood", expected="true or false", got=got)
        for name in ("frame", "bad_rows"):
            if not isinstance(getattr(self, name), str | None):
                got = _short(getattr(self, name))
                raise BadInput(f"{name} of a star list is not understood", expected="a word", got=got)


def _short(value: object) -> str:
    return repr(value)[:60]


def plain_unit(name: str, unit: str) -> str:
    """Return the unit of a field in GSS spelling. Raises BadInput if the unit is not known."""
    check_unit(unit)
    text = str(unit).strip().lower().replace(" ", "").replace("**-1", "-1").replace("^-1", "-1")
    if match := re.fullmatch(r"(.+?)(?:/|\.?)(a|y|yr|year|cy|century|ha)(-1)?", text):
        angle, time, power = match.groups()
        if "/" in text or power:
            angle = angle.rstrip("./")
            text = f"{SPELLINGS.get(angle, angle)}/{TIMES[time]}"
    text = SPELLINGS.get(text, text)
    if name in UNITS_OF and text not in UNITS_OF[name]:
        raise BadInput(f"unknown unit of {name}", expected=" | ".join(UNITS_OF[name]), got=str(unit))
    return text


def factor_of(name: str, unit: str) -> float:
    """Return the factor from a unit to radians or radians per year; 1 for fields that are not angles. The unit is in
    GSS spelling and not sexagesimal."""
    return ANGLE_UNITS.get(unit) or MOTION_UNITS.get(unit) or 1.0


def columns_of(names: list[str], mapping: ListMapping) -> dict[str, str]:
    """Map the fields to the columns of the file. Raises BadInput if a required column is missing or a field is
    ambiguous."""
    columns: dict[str, str] = {}
    for ours, column in mapping.columns.items():
        if column not in names:
            raise BadInput(
                f"the star list has no column {column!r}", expected=" | ".join(names), got=f"{ours} = {column}"
            )
        columns[ours] = column
    plain: dict[str, list[str]] = {}
    for name in names:
        plain.setdefault(_plain(name), []).append(name)
    for ours, usual in USUAL_NAMES.items():
        if ours not in columns:
            hit = next((plain[name] for name in usual if name in plain), None)
            if hit is not None:
                columns[ours] = _only(ours, hit)
    _each_once(columns)
    missing = [name for name in REQUIRED if name not in columns]
    if missing:
        raise BadInput(
            f"the star list has no column for {', '.join(missing)}",
            expected="columns for ra, dec and v",
            got=", ".join(names) or "no columns",
            hint="name them: columns = {" + ", ".join(f'"{name}": "…"' for name in missing) + "}",
        )
    return columns


def _each_once(columns: Mapping[str, str]) -> None:
    """Raise BadInput if a column is used for two fields, unless one of them is the name."""
    for ours, theirs in columns.items():
        others = [name for name, column in columns.items() if column == theirs and "name" not in (name, ours)]
        if len(others) > 1:
            raise BadInput(
                f"column {theirs!r} is used twice",
                expected="a column for each field",
                got=" and ".join(others),
                hint="name another column for one of them",
            )


def unit_in_name(ours: str, column: str) -> str | None:
    """Return the unit at the end of a column's name, as in ``ra_deg`` or ``pm_ra_mas_yr``; None if there is no unit."""
    text = column.strip().lower()
    for unit in sorted(UNITS_OF.get(ours, ()), key=len, reverse=True):
        if text.endswith(("_" + unit.replace("/", "_"), f"[{unit}]", f"({unit})", f" {unit}")):
            return unit
    return "hourangle" if ours == "ra" and _plain(column) == "rahours" else None


def _plain(name: str) -> str:
    text = re.sub(r"\[[^\[\]]*\]|\([^()]*\)", "", name.strip().lower())
    text = re.sub(r"[_ ](deg|rad|hourangle|arcsec|mas|arcmin|mag|mas_yr|arcsec_yr|deg_yr|rad_yr)$", "", text)
    return re.sub(r"[^a-z0-9]", "", text)


def _only(ours: str, hits: list[str]) -> str:
    if len(hits) > 1:
        raise BadInput(
            f"two columns could be {ours}", expected="one", got=" and ".join(hits), hint=f"name the one for {ours}"
        )
    return hits[0]
