"""Write types, parameters and arguments of an XTCE document from the values of a dictionary."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree as ET

from gss.device.protocol.codec import STRUCT
from gss.domain.errors import BadInput
from gss.domain.limits import Limits
from gss.instruments.dictionary import xtce_terms as terms
from gss.instruments.dictionary.definitions import (
    FLOATS,
    INTEGER_RANGES,
    Argument,
    Hazard,
    Item,
    TelemetryField,
    Value,
)

NAME = re.compile(r"[^./:\[\] \t\r\n]+")
MAX_TEXT_LENGTH = 255


def checked_name(name: str) -> str:
    """Return the name. Raises BadInput if XTCE does not allow it."""
    if not NAME.fullmatch(name):
        raise BadInput("XTCE does not allow this name", expected="a name without . / : [ ] and spaces", got=name[:80])
    return name


def named(parent: ET.Element, tag: str, name: str, attributes: Mapping[str, str] | None = None) -> ET.Element:
    """Add an element with a name. Raises BadInput if XTCE does not allow the name."""
    return ET.SubElement(parent, tag, {"name": checked_name(name), **(attributes or {})})


def add_facts(element: ET.Element, facts: Mapping[str, Any], at: int | None = None) -> None:
    """Add the properties for which XTCE has no element, if there are any."""
    if facts:
        fact_set = ET.Element("AncillaryDataSet")
        entry = ET.SubElement(fact_set, "AncillaryData", name=terms.ANCILLARY, mimeType=terms.JSON_TYPE)
        entry.text = json.dumps(facts, ensure_ascii=False, separators=(",", ":"))
        element.insert(len(element) if at is None else at, fact_set)


def dynamic(size: ET.Element, parameter: str, slope: int, intercept: int) -> None:
    """Add a size in bits: slope · parameter + intercept."""
    dynamic_value = ET.SubElement(size, "DynamicValue")
    ET.SubElement(dynamic_value, "ParameterInstanceRef", parameterRef=parameter)
    ET.SubElement(dynamic_value, "LinearAdjustment", slope=str(slope), intercept=str(intercept))


class TypeWriter:
    """Writes types, and the parameters or arguments that use them. ``kind``: Parameter or Argument."""

    def __init__(self, types: ET.Element, kind: str, little_endian: bool) -> None:
        self._types, self._kind, self._little = types, kind, little_endian

    def unsigned(self, entries: ET.Element, name: str, bits: int, purpose: str, facts: Mapping[str, Any]) -> None:
        """Add an unsigned integer: a header field, a count or a length."""
        element = self.make("Integer", name)
        element.set("signed", "false")
        self._integer_encoding(element, bits, signed=False)
        self.entry(entries, name, name, {"shortDescription": purpose}, facts)

    def make(self, kind: str, name: str, unit: str = "") -> ET.Element:
        """Add a type with its unit."""
        element = named(self._types, f"{kind}{self._kind}Type", name)
        units = ET.SubElement(element, "UnitSet")
        if unit:
            ET.SubElement(units, "Unit").text = unit
        return element

    def entry(
        self,
        entries: ET.Element,
        name: str,
        type_name: str,
        attributes: Mapping[str, str],
        facts: Mapping[str, Any],
        purpose: str = "",
    ) -> None:
        """Add a parameter or argument."""
        reference = "parameterTypeRef" if self._kind == "Parameter" else "argumentTypeRef"
        non_empty = {key: text for key, text in attributes.items() if text or key == "initialValue"}
        element = named(entries, self._kind, name, {reference: type_name, **non_empty})
        if purpose:
            ET.SubElement(element, "LongDescription").text = purpose
        add_facts(element, facts)

    def value(self, name: str, item: Item, around: int) -> dict[str, object]:
        """Add the type of a value. Returns the properties that the type cannot express.

        ``around``: size in bytes of the packet after the primary header, without this value.
        """
        if terms.is_utc(item.name, item.type) and item.unit == "s":
            return self._time(name, item)
        if item.type in INTEGER_RANGES or item.type in ("bool", "enum", *FLOATS):
            return self._number(name, item)
        if item.type in ("bytes", "rest"):
            encoding = ET.SubElement(self.make("Binary", name, item.unit), "BinaryDataEncoding")
            size = ET.SubElement(encoding, "SizeInBits")
            if item.type == "rest":
                dynamic(size, "PKT_LEN", 8, 8 - 8 * around)
            else:
                ET.SubElement(size, "FixedValue").text = str(8 * item.size)
        else:
            encoding = ET.SubElement(self.make("String", name, item.unit), "StringDataEncoding", encoding="UTF-8")
            if item.type == "text":
                variable = ET.SubElement(encoding, "Variable", maxSizeInBits=str(8 * MAX_TEXT_LENGTH))
                dynamic(variable, f"{name}_length", 8, 0)
            else:
                size = ET.SubElement(encoding, "SizeInBits")
                ET.SubElement(ET.SubElement(size, "Fixed"), "FixedValue").text = str(8 * item.size)
                ET.SubElement(size, "TerminationChar").text = "00"
        return _limits_of(item) | _range_of(item)

    # --- numbers ------------------------------------------------------------------------------------------------------

    def _time(self, name: str, item: Item) -> dict[str, object]:
        element = named(self._types, f"AbsoluteTime{self._kind}Type", name)
        encoding = ET.SubElement(element, "Encoding", units="seconds")
        self._float_encoding(encoding, item.type)
        ET.SubElement(ET.SubElement(element, "ReferenceTime"), "Epoch").text = "UNIX"
        return _limits_of(item) | _range_of(item)

    def _number(self, name: str, item: Item) -> dict[str, object]:
        bits = 8 * STRUCT[item.type].size
        coefficients = item.conversion.coefficients if isinstance(item, TelemetryField) else ()
        kind = {"bool": "Boolean", "enum": "Enumerated"}.get(item.type, "Integer")
        if item.type in FLOATS or (coefficients and kind == "Integer"):
            kind = "Float"
        element = self.make(kind, name, item.unit)
        if item.type in FLOATS:
            element.set("sizeInBits", str(bits))
            encoding = self._float_encoding(element, item.type)
        else:
            signed = item.type.startswith("i")
            if kind == "Integer":
                element.set("signed", str(signed).lower())
                element.set("sizeInBits", str(bits))
            elif kind == "Float":
                element.set("sizeInBits", "64")
            encoding = self._integer_encoding(element, bits, signed)
        if coefficients:
            polynomial = ET.SubElement(ET.SubElement(encoding, "DefaultCalibrator"), "PolynomialCalibrator")
            for power, coefficient in enumerate(coefficients):
                ET.SubElement(polynomial, "Term", coefficient=repr(float(coefficient)), exponent=str(power))
        if item.type == "enum":
            listed = ET.SubElement(element, "EnumerationList")
            for choice in item.choices:
                note = {"shortDescription": choice.note} if choice.note else {}
                ET.SubElement(listed, "Enumeration", {"value": str(choice.value), "label": choice.name, **note})
        if kind in ("Boolean", "Enumerated"):
            return _limits_of(item) | _range_of(item) | _hazards_of(item)
        return self._ranges(element, item, kind == "Integer")

    def _integer_encoding(self, element: ET.Element, bits: int, signed: bool) -> ET.Element:
        facts = {"sizeInBits": str(bits), "encoding": "twosComplement" if signed else "unsigned"}
        return ET.SubElement(element, "IntegerDataEncoding", facts | self._order(bits))

    def _float_encoding(self, element: ET.Element, kind: str) -> ET.Element:
        bits = 8 * STRUCT[kind].size
        facts = {"sizeInBits": str(bits), "encoding": "IEEE754_1985"}
        return ET.SubElement(element, "FloatDataEncoding", facts | self._order(bits))

    def _order(self, bits: int) -> dict[str, str]:
        return {"byteOrder": terms.LITTLE_ENDIAN} if self._little and bits > 8 and bits % 8 == 0 else {}

    def _ranges(self, element: ET.Element, item: Item, integer: bool) -> dict[str, object]:
        """Add the valid range and alarms of a number. Returns the properties that they cannot express."""
        if isinstance(item, Argument):
            return _argument_range(element, item)
        if not isinstance(item, TelemetryField):
            return {}
        facts: dict[str, object] = {}
        if item.valid is not None:
            low, high = item.valid
            fits_long = low.is_integer() and high.is_integer() and int(low) in terms.LONG and int(high) in terms.LONG
            if integer and not fits_long:
                facts["valid"] = [low, high]
            else:
                bounds = (int(low), int(high)) if integer else (low, high)
                ET.SubElement(element, "ValidRange", minInclusive=repr(bounds[0]), maxInclusive=repr(bounds[1]))
        if not item.limits.any:
            return facts | _persistence(item)
        alarm = ET.SubElement(element, "DefaultAlarm")
        if item.persistence != 1:
            alarm.attrib |= {"minViolations": str(item.persistence), "minConformance": str(item.persistence)}
        ranges = ET.SubElement(alarm, "StaticAlarmRanges")
        for level, tag in terms.ALARMS.items():
            ends = dict(zip(("minInclusive", "maxInclusive"), getattr(item.limits, level), strict=True))
            if any(end is not None for end in ends.values()):
                ET.SubElement(ranges, tag, {key: repr(end) for key, end in ends.items() if end is not None})
        return facts


def _argument_range(element: ET.Element, argument: Argument) -> dict[str, object]:
    low, high = argument.minimum, argument.maximum
    if low is None or high is None:
        return _range_of(argument)
    if argument.type in INTEGER_RANGES:
        if (low, high) == INTEGER_RANGES[argument.type]:
            return {}
        if int(low) != low or int(high) != high or int(low) not in terms.LONG or int(high) not in terms.LONG:
            return _range_of(argument)
        low, high = int(low), int(high)
    ranges = ET.SubElement(element, "ValidRangeSet")
    ET.SubElement(ranges, "ValidRange", minInclusive=repr(low), maxInclusive=repr(high))
    return {}


def _persistence(item: TelemetryField) -> dict[str, object]:
    return {"persistence": item.persistence} if item.persistence != 1 else {}


def limit_rows(limits: Limits) -> dict[str, list[float | None]]:
    """Return the limits as key–value pairs of a row."""
    rows = {level: list(getattr(limits, level)) for level in terms.ALARMS}
    return {level: pair for level, pair in rows.items() if any(bound is not None for bound in pair)}


def _limits_of(item: Item) -> dict[str, object]:
    """Return the limits and the valid range of a value whose type cannot express them."""
    if not isinstance(item, TelemetryField):
        return {}
    valid = {"valid": list(item.valid)} if item.valid is not None else {}
    return limit_rows(item.limits) | valid | _persistence(item)


def _range_of(item: Item) -> dict[str, object]:
    if not isinstance(item, Argument):
        return {}
    return {k: v for k, v in (("min", item.minimum), ("max", item.maximum)) if v is not None}


def _hazards_of(item: Item) -> dict[str, object]:
    hazards = {c.name: str(c.hazard) for c in item.choices if c.hazard is not Hazard.NONE}
    return {"choice_hazards": hazards} if hazards else {}


def initial_value(value: Value) -> str:
    """Return a default value as the text of ``initialValue``."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, bytes):
        return value.hex()
    return value if isinstance(value, str) else repr(value)
