"""Terms of XTCE 1.2 (CCSDS 660.0-B-2), shared by writer and reader of dictionaries.

Properties for which XTCE has no element are JSON in an ``AncillaryData`` with the name ``gss``. The keys are those of
``dictionary.yaml`` and the keys in this module.
"""

from __future__ import annotations

from gss.instruments.dictionary.items import Hazard

NAMESPACE = "http://www.omg.org/spec/XTCE/20180204"
FAMILY = "http://www.omg.org/spec/XTCE/"
"""Start of the namespaces of XTCE 1.2 and later."""
ANCILLARY, JSON_TYPE = "gss", "application/json"
ROLE = "role_of_container"
"""Key for the role of a container or parameter, with one of the values below. If the key is missing, a container with a
comparison is a packet."""
HEADER, TELEMETRY, EVENT, SERVICE = "header", "telemetry", "event", "service"
RETURNS, STAGE, ROW, CHECKSUM = "returns", "stage", "row", "checksum"
LEVELS = {Hazard.WATCH: "user1", Hazard.WARNING: "vital", Hazard.CRITICAL: "critical"}
"""Consequence level by hazard; XTCE has two named levels, "vital" and "critical", and two for projects."""
OPERATORS = {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}
ALARMS = {"watch": "WatchRange", "warning": "WarningRange", "critical": "CriticalRange"}
LITTLE_ENDIAN, BIG_ENDIAN = "leastSignificantByteFirst", "mostSignificantByteFirst"
LONG = range(-(1 << 63), 1 << 63)
"""Range of the integers in XTCE (xs:long)."""


def is_utc(name: str, kind: str) -> bool:
    """True if a value is an absolute time: seconds since 1970-01-01 UTC, by the dictionary's rule for names."""
    return kind == "f64" and (name == "utc_s" or name.endswith("_utc_s"))
