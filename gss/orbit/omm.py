"""Reader of CCSDS Orbit Mean-elements Messages (CCSDS 502.0-B-3 §4) in KVN, XML and the JSON of satellite catalogues, and
writer of their fields."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from xml.etree import ElementTree

from sgp4 import omm
from sgp4.api import Satrec
from sgp4.exporter import export_omm, export_tle

from gss.catalogue_tools.envelope.orbits import read_tle
from gss.domain.errors import BadInput

REQUIRED = (
    "MEAN_MOTION",
    "ECCENTRICITY",
    "INCLINATION",
    "RA_OF_ASC_NODE",
    "ARG_OF_PERICENTER",
    "MEAN_ANOMALY",
)
DEFAULTS = {
    "CLASSIFICATION_TYPE": "U",
    "OBJECT_ID": "",
    "EPHEMERIS_TYPE": "0",
    "ELEMENT_SET_NO": "0",
    "REV_AT_EPOCH": "0",
    "NORAD_CAT_ID": "0",
    "MEAN_MOTION_DOT": "0",
    "MEAN_MOTION_DDOT": "0",
    "BSTAR": "0",
}
ALLOWED = {
    "CENTER_NAME": ("EARTH",),
    "REF_FRAME": ("TEME",),
    "TIME_SYSTEM": ("UTC",),
    "MEAN_ELEMENT_THEORY": ("SGP4", "SGP/SGP4"),
}
WHOLE = ("EPHEMERIS_TYPE", "ELEMENT_SET_NO", "REV_AT_EPOCH", "NORAD_CAT_ID")
MAX_FIELDS = 200
MAX_NUMBER = 339_999
"""Largest catalogue number that a TLE can represent (Alpha-5)."""
MAX_DIGITS = 20
FIRST_YEAR, LAST_YEAR = 1957, 2056
"""Years that a TLE can represent with two digits."""


def fields_of_json(content: object) -> dict[str, str]:
    """Return the fields of a JSON OMM, which is an object or a list with one object. Raises BadInput."""
    if isinstance(content, list) and len(content) != 1:
        raise BadInput(
            "the OMM has several objects", expected="one object", got=str(len(content)), hint="Import one satellite."
        )
    record = content[0] if isinstance(content, list) else content
    if not isinstance(record, dict) or len(record) > MAX_FIELDS:
        raise BadInput("the JSON is not an OMM", expected="an object of OMM fields", got=str(record)[:60])
    return {str(key): "" if value is None else str(value).strip() for key, value in record.items()}


def fields_of_kvn(text: str) -> dict[str, str]:
    """Return the fields of a KVN OMM. Raises BadInput that names the invalid line."""
    fields: dict[str, str] = {}
    for number, line in enumerate(text.splitlines(), 1):
        statement = line.strip()
        if not statement or statement.startswith("COMMENT"):
            continue
        key, sign, value = statement.partition("=")
        if not sign:
            raise BadInput(f"line {number} of the OMM is not valid", expected="KEYWORD = value", got=statement[:60])
        fields[key.strip()] = value.partition("[")[0].strip()
    return fields


def fields_of_xml(text: str) -> dict[str, str]:
    """Return the fields of an XML OMM with one segment. Raises BadInput if the text is not valid or declares
    entities."""
    if "<!" in text.replace("<!--", ""):
        raise BadInput("the XML contains declarations", expected="an OMM without DOCTYPE, entities or CDATA")
    try:
        root = ElementTree.fromstring(text)  # noqa: S314 - without declarations there are no entities to expand
    except (ElementTree.ParseError, ValueError) as error:
        raise BadInput("the XML cannot be read", expected="a CCSDS OMM", got=str(error)[:120]) from None
    segments = root.findall(".//segment")
    if len(segments) != 1:
        raise BadInput("the XML is not an OMM of one satellite", expected="one segment", got=str(len(segments)))
    return {node.tag: (node.text or "").strip() for node in segments[0].iter() if not len(node)}


def tle_of_omm(fields: Mapping[str, str]) -> str:
    """Return the elements of an OMM as the two lines of a TLE. Raises BadInput that names the missing or invalid field."""
    for name, allowed in ALLOWED.items():
        if fields.get(name) and fields[name].upper() not in allowed:
            raise BadInput(f"{name} of the OMM is not supported", expected=" or ".join(allowed), got=fields[name][:40])
    complete = DEFAULTS | {key: value for key, value in fields.items() if value}
    for name in REQUIRED:
        _number(name, complete.get(name, ""))
    if float(complete["MEAN_MOTION"]) <= 0 or not 0 <= float(complete["ECCENTRICITY"]) < 1:
        raise BadInput(
            "the OMM describes no orbit",
            expected="MEAN_MOTION above 0, and ECCENTRICITY from 0 to below 1",
            got=f"{complete['MEAN_MOTION'][:20]} and {complete['ECCENTRICITY'][:20]}",
        )
    for name in ("MEAN_MOTION_DOT", "MEAN_MOTION_DDOT", "BSTAR"):
        _number(name, complete[name])
    for name in WHOLE:
        digits = complete[name]
        if not digits.isdecimal() or len(digits) > MAX_DIGITS or int(digits) > MAX_NUMBER:
            raise BadInput(f"{name} of the OMM is out of range", expected=f"0 to {MAX_NUMBER}", got=complete[name][:40])
    for name in ("CLASSIFICATION_TYPE", "OBJECT_ID"):
        if not complete[name].isascii():
            raise BadInput(f"{name} of the OMM is not valid", expected="ASCII characters", got=complete[name][:40])
    epoch = omm_epoch(complete.get("EPOCH", ""))
    if not FIRST_YEAR <= epoch.year <= LAST_YEAR:
        raise BadInput(
            "EPOCH of the OMM is out of range", expected=f"years {FIRST_YEAR} to {LAST_YEAR}", got=str(epoch.year)
        )
    complete |= {
        "EPOCH": epoch.strftime("%Y-%m-%dT%H:%M:%S.%f"),
        "CLASSIFICATION_TYPE": complete["CLASSIFICATION_TYPE"][:1],
        "OBJECT_ID": complete["OBJECT_ID"][:11],
        "REV_AT_EPOCH": str(int(complete["REV_AT_EPOCH"]) % 100_000),
        "ELEMENT_SET_NO": str(int(complete["ELEMENT_SET_NO"]) % 10_000),
    }
    satellite = Satrec()
    try:
        omm.initialize(satellite, complete)
        tle = "\n".join(export_tle(satellite)) + "\n"
    except (ValueError, KeyError, OverflowError) as error:
        raise BadInput("the OMM describes no orbit", expected="mean elements of SGP4", got=str(error)[:120]) from None
    read_tle(tle)
    return tle


def omm_of_tle(name: str, tle: str) -> dict[str, object]:
    """Return a TLE as the fields of an OMM."""
    satellite = read_tle(tle)
    if not satellite.intldesg.strip()[:2].isdigit():
        satellite.intldesg = "00000A"
    fields: dict[str, object] = export_omm(satellite, name)
    return fields


def omm_epoch(text: str) -> datetime:
    """Parse a CCSDS time in UTC, with a calendar date or a day of the year. Raises BadInput."""
    epoch = text.strip().removesuffix("Z")
    for form in ("%Y-%m-%dT%H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S", "%Y-%jT%H:%M:%S.%f", "%Y-%jT%H:%M:%S"):
        try:
            return datetime.strptime(_microseconds(epoch), form).replace(tzinfo=UTC)
        except ValueError:
            continue
    raise BadInput("a time of the file is not valid", expected="2026-12-01T18:00:00.000", got=text[:40] or "no time")


def _microseconds(epoch: str) -> str:
    """Return the text of a time, truncated to six decimals, because Python cannot parse more decimals."""
    seconds, dot, decimals = epoch.partition(".")
    return seconds + dot + decimals[:6] if decimals else seconds


def _number(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise BadInput(f"{name} of the OMM is missing or not a number", expected="a number", got=text[:40] or "nothing")
    return value
