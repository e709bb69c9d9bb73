"""Convert the types of XTCE parameters and arguments to dictionary rows. An error about an unsupported construct states
its name and line."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from gss.domain.json_object import JsonObject
from gss.instruments.dictionary.definitions import INTEGER_RANGES
from gss.instruments.dictionary.xml_lines import Element
from gss.instruments.dictionary.xtce_terms import ALARMS, ANCILLARY, BIG_ENDIAN, LITTLE_ENDIAN

Row = JsonObject
COMMON_CHILDREN = "LongDescription AliasSet AncillaryDataSet"
COMMON_ATTRIBUTES = "name shortDescription"
INTEGERS = {("unsigned", 8): "u8", ("unsigned", 16): "u16", ("unsigned", 32): "u32", ("unsigned", 64): "u64"}
INTEGERS |= {("twosComplement", 8): "i8", ("twosComplement", 16): "i16", ("twosComplement", 32): "i32"}
FLOATS = {"32": "f32", "64": "f64"}
YES, NO = ("true", "1"), ("false", "0")
MAX_JSON, MAX_BRACKETS = 50_000, 200


@dataclass(frozen=True)
class Size:
    """Size of a binary value or text in bits: fixed, or ``slope`` · parameter + ``intercept``."""

    fixed: int = 0
    parameter: str = ""
    slope: int = 1
    intercept: int = 0


def facts_of(element: Element, allowed: str) -> Row:
    """Return the JSON in the ``AncillaryData`` of GSS. Other ``AncillaryData`` are ignored. Raises BadInput for a key
    that is not in ``allowed``."""
    facts: Row = {}
    for entry in element.rows("AncillaryDataSet"):
        if entry.attributes.get("name") != ANCILLARY:
            continue
        if len(entry.text) > MAX_JSON or entry.text.count("[") + entry.text.count("{") > MAX_BRACKETS:
            raise entry.error("JSON is too long", expected=f"up to {MAX_JSON} characters and {MAX_BRACKETS} brackets")
        try:
            facts = json.loads(entry.text, parse_constant=_reject_constant)
        except ValueError as error:
            raise entry.error("is not valid JSON", got=str(error)[:100]) from None
        unknown = sorted(set(facts) - set(allowed.split())) if isinstance(facts, dict) else [str(facts)[:60]]
        if unknown:
            raise entry.error(f"unknown key {unknown[0]} in {element.tag}", expected=allowed)
    return facts


def _reject_constant(constant: str) -> None:
    raise ValueError(f"{constant} is not a number")


def descriptions(element: Element) -> tuple[str, str]:
    """Return the short and the long description, "" for a missing one."""
    long = element.child("LongDescription")
    return element.attributes.get("shortDescription", ""), long.text if long else ""


def boolean_attribute(element: Element, attribute: str, default: bool) -> bool:
    """Return a boolean attribute. Raises BadInput if its text is not a boolean."""
    text = element.attributes.get(attribute, str(default).lower())
    if text not in YES + NO:
        raise element.error(f"{attribute} is not a boolean", expected="true or false", got=text[:40])
    return text in YES


class TypeReader:
    """Reads the types of a document. ``kind``: Parameter or Argument. ``enums`` and ``orders`` collect the
    enumerations and the byte orders of the numbers.

    Limitations: sizes are whole bytes; calibrators are polynomials; ranges are inclusive; alarm ranges are static, and
    a value outside of the range raises the alarm.
    """

    def __init__(self, types: Iterable[Element], kind: str, enums: dict[str, list[Row]], orders: set[str]) -> None:
        self._types: dict[str, Element] = {}
        for element in types:
            if self._types.setdefault(element.get("name"), element) is not element:
                raise element.error("appears twice")
        self._kind, self._enums, self._orders = kind, enums, orders

    def row(self, entry: Element, facts: Row) -> tuple[Row, Size | None]:
        """Return the row of a parameter or argument without its name, and the size of its value if this size is
        variable, otherwise None."""
        reference = entry.get("parameterTypeRef" if self._kind == "Parameter" else "argumentTypeRef")
        element = self._types.get(reference)
        if element is None:
            raise entry.error(f"unknown type {reference}"[:120])
        readers = {"Integer": self._integer, "Float": self._float, "Boolean": self._boolean, "String": self._string}
        readers |= {"Enumerated": self._enumerated, "Binary": self._binary, "AbsoluteTime": self._time}
        read = readers.get(element.tag.removesuffix(f"{self._kind}Type"))
        if read is None:
            raise element.error("this type is not supported", expected=", ".join(readers))
        row: Row = {}
        unit = self._unit(element)
        if unit:
            row["unit"] = unit
        size = read(element, row)
        row |= {key: value for key, value in facts.items() if key != "choice_hazards"}
        if "choice_hazards" in facts:
            self._hazards(element, facts["choice_hazards"])
        return row, size

    # --- kinds --------------------------------------------------------------------------------------------------------

    def _integer(self, element: Element, row: Row) -> Size | None:
        self._checked(element, "IntegerDataEncoding", "sizeInBits signed")
        self._whole_number(element, row)
        if "conversion" in row:
            raise element.error(
                "an integer with a calibrator must be a FloatParameterType", expected="no DefaultCalibrator"
            )
        if boolean_attribute(element, "signed", True) != row["type"].startswith("i"):
            raise element.error("the attribute signed contradicts the encoding")
        self._ranges(element, row)
        if self._kind == "Argument":
            low, high = INTEGER_RANGES[row["type"]]
            row.setdefault("min", low)
            row.setdefault("max", high)
        return None

    def _float(self, element: Element, row: Row) -> Size | None:
        self._checked(element, "IntegerDataEncoding FloatDataEncoding", "sizeInBits")
        encoding = element.child("FloatDataEncoding")
        if encoding is None:
            self._whole_number(element, row)
            if self._kind == "Argument":
                raise element.error("calibrators of arguments are not supported", expected="FloatDataEncoding")
        else:
            self._float_encoding(encoding, row)
            self._calibrator(encoding, row)
        self._ranges(element, row)
        return None

    def _float_encoding(self, encoding: Element, row: Row) -> None:
        encoding.checked("DefaultCalibrator", "sizeInBits encoding byteOrder bitOrder")
        bits = encoding.attributes.get("sizeInBits", "32")
        if bits not in FLOATS or encoding.attributes.get("encoding", "IEEE754_1985") not in (
            "IEEE754_1985",
            "IEEE754",
        ):
            raise encoding.error("only IEEE 754 of 32 or 64 bits is supported", got=bits[:20])
        self._order(encoding)
        row["type"] = FLOATS[bits]

    def _boolean(self, element: Element, row: Row) -> Size | None:
        self._checked(element, "IntegerDataEncoding", "")
        self._whole_number(element, row, only="u8")
        row["type"] = "bool"
        return None

    def _enumerated(self, element: Element, row: Row) -> Size | None:
        self._checked(element, "IntegerDataEncoding EnumerationList", "")
        self._whole_number(element, row, only="u8")
        choices = []
        for choice in element.need("EnumerationList").checked("Enumeration").children:
            choice.checked("", "value label shortDescription")
            value: Row = {"name": choice.get("label"), "value": choice.integer(choice.get("value"))}
            note = choice.attributes.get("shortDescription")
            choices.append(value | ({"note": note} if note else {}))
        name = f"{self._kind} {element.get('name')}"
        self._enums.setdefault(name, choices)
        row |= {"type": "enum", "enum": name}
        return None

    def _hazards(self, element: Element, hazards: Any) -> None:
        choices = self._enums.get(f"{self._kind} {element.get('name')}", [])
        names = {choice["name"]: choice for choice in choices}
        if not isinstance(hazards, dict) or not set(hazards) <= set(names):
            raise element.error("choice_hazards contains an unknown choice", got=str(hazards)[:100])
        for name, hazard in hazards.items():
            names[name]["hazard"] = hazard

    def _string(self, element: Element, row: Row) -> Size | None:
        encoding = self._checked(element, "StringDataEncoding", "").need("StringDataEncoding")
        encoding.checked("SizeInBits Variable", "encoding")
        if encoding.attributes.get("encoding", "UTF-8") not in ("UTF-8", "US-ASCII"):
            raise encoding.error(
                "encoding is not supported", expected="UTF-8", got=encoding.attributes["encoding"][:40]
            )
        variable = encoding.child("Variable")
        if variable is not None:
            row["type"] = "text"
            return self._size(variable.checked("DynamicValue", "maxSizeInBits"))
        size = encoding.need("SizeInBits").checked("Fixed TerminationChar")
        end = size.child("TerminationChar")
        if end is not None and end.text.strip() not in ("00", ""):
            raise end.error("only zero bytes can terminate a text", expected="00", got=end.text[:20])
        fixed = size.need("Fixed").checked("FixedValue").need("FixedValue")
        row["type"] = f"str{self._bytes(fixed, fixed.text)}"
        return None

    def _binary(self, element: Element, row: Row) -> Size | None:
        encoding = self._checked(element, "BinaryDataEncoding", "").need("BinaryDataEncoding")
        size = self._size(encoding.checked("SizeInBits", "bitOrder byteOrder").need("SizeInBits"))
        row["type"] = f"bytes{size.fixed // 8}" if size.fixed else "rest"
        return None if size.fixed else size

    def _time(self, element: Element, row: Row) -> Size | None:
        element.checked(f"{COMMON_CHILDREN} Encoding ReferenceTime", COMMON_ATTRIBUTES)
        encoding = element.need("Encoding").checked("FloatDataEncoding IntegerDataEncoding", "units scale offset")
        plain = (
            encoding.attributes.get("units", "seconds"),
            float(encoding.number(encoding.attributes.get("scale", "1"))),
        )
        if (*plain, float(encoding.number(encoding.attributes.get("offset", "0")))) != ("seconds", 1.0, 0.0):
            raise encoding.error("only plain seconds are supported", expected="units seconds, scale 1, offset 0")
        epoch = element.need("ReferenceTime").checked("Epoch").need("Epoch")
        if epoch.text.strip() != "UNIX":
            raise epoch.error("only times since 1970-01-01 UTC are supported", expected="UNIX", got=epoch.text[:40])
        number = encoding.child("FloatDataEncoding")
        if number is None:
            self._whole_number(encoding, row)
        else:
            self._float_encoding(number.checked("", "sizeInBits encoding byteOrder bitOrder"), row)
        row["unit"] = "s"
        return None

    # --- parts --------------------------------------------------------------------------------------------------------

    def _checked(self, element: Element, children: str, attributes: str) -> Element:
        extra = "ValidRangeSet" if self._kind == "Argument" else "ValidRange DefaultAlarm"
        numeric = extra if element.tag.startswith(("Integer", "Float")) else ""
        return element.checked(f"{COMMON_CHILDREN} UnitSet {children} {numeric}", f"{COMMON_ATTRIBUTES} {attributes}")

    def _unit(self, element: Element) -> str:
        units = list(element.rows("UnitSet"))
        if len(units) > 1:
            raise units[1].error("a product of units is not supported; write it as one unit")
        return units[0].checked("", "description form").text.strip() if units else ""

    def _whole_number(self, element: Element, row: Row, only: str = "") -> None:
        encoding = element.need("IntegerDataEncoding").checked(
            "DefaultCalibrator", "sizeInBits encoding byteOrder bitOrder"
        )
        bits = encoding.integer(encoding.attributes.get("sizeInBits", "8"))
        kind = INTEGERS.get((encoding.attributes.get("encoding", "unsigned"), bits))
        if kind is None or (only and kind != only):
            raise encoding.error(
                "this size or encoding is not supported",
                expected="8 bits, unsigned"
                if only
                else "unsigned 8, 16, 32, 64 bits, or twosComplement 8, 16, 32 bits",
                got=f"{bits} bits, {encoding.attributes.get('encoding', 'unsigned')}"[:60],
            )
        row["type"] = kind
        if bits > 8:
            self._order(encoding)
        self._calibrator(encoding, row)

    def _order(self, encoding: Element) -> None:
        order = encoding.attributes.get("byteOrder", BIG_ENDIAN)
        if order not in (BIG_ENDIAN, LITTLE_ENDIAN):
            raise encoding.error("this byte order is not supported", got=order[:60])
        if encoding.attributes.get("bitOrder", "mostSignificantBitFirst") != "mostSignificantBitFirst":
            raise encoding.error("this bit order is not supported", expected="mostSignificantBitFirst")
        self._orders.add(order)
        if len(self._orders) > 1:
            raise encoding.error("numbers of both byte orders in one dictionary are not supported")

    def _calibrator(self, encoding: Element, row: Row) -> None:
        calibrator = encoding.child("DefaultCalibrator")
        if calibrator is None:
            return
        if self._kind == "Argument":
            raise calibrator.error(
                "calibrators of arguments are not supported", expected="the argument in the unit that is sent"
            )
        coefficients: dict[int, float] = {}
        polynomial = calibrator.checked("PolynomialCalibrator", "name").need("PolynomialCalibrator")
        for term in polynomial.checked("Term").children:
            term.checked("", "coefficient exponent")
            exponent = term.integer(term.get("exponent"))
            if not 0 <= exponent <= 20 or exponent in coefficients:
                raise term.error("exponent is out of range, or appears twice", expected="0 – 20", got=str(exponent))
            coefficients[exponent] = float(term.number(term.get("coefficient")))
        if not coefficients:
            raise polynomial.error("has no Term")
        row["conversion"] = {"polynomial": [coefficients.get(n, 0.0) for n in range(max(coefficients) + 1)]}

    def _ranges(self, element: Element, row: Row) -> None:
        if self._kind == "Argument":
            self._argument_range(element, row)
            return
        valid = element.child("ValidRange")
        if valid is not None:
            valid.checked("", "minInclusive maxInclusive validRangeAppliesToCalibrated")
            if not boolean_attribute(valid, "validRangeAppliesToCalibrated", True):
                raise valid.error("the range must apply to the calibrated value")
            row["valid"] = [valid.number(valid.get("minInclusive")), valid.number(valid.get("maxInclusive"))]
        alarm = element.child("DefaultAlarm")
        if alarm is None:
            return
        alarm.checked("StaticAlarmRanges", "minViolations minConformance name")
        count = alarm.integer(alarm.attributes.get("minViolations", "1"))
        if alarm.integer(alarm.attributes.get("minConformance", str(count))) != count:
            raise alarm.error("minViolations and minConformance must be equal")
        ranges = alarm.need("StaticAlarmRanges").checked(" ".join(ALARMS.values()), "rangeForm")
        if ranges.attributes.get("rangeForm", "outside") != "outside":
            raise ranges.error("only alarms outside of a range are supported", expected="outside")
        row["persistence"] = count
        for level, tag in ALARMS.items():
            limits = ranges.child(tag)
            if limits is not None:
                limits.checked("", "minInclusive maxInclusive")
                pair = (limits.attributes.get(name) for name in ("minInclusive", "maxInclusive"))
                row[level] = [None if bound is None else limits.number(bound) for bound in pair]

    def _argument_range(self, element: Element, row: Row) -> None:
        ranges = element.child("ValidRangeSet")
        if ranges is None:
            return
        valid = ranges.checked("ValidRange", "validRangeAppliesToCalibrated").need("ValidRange")
        valid.checked("", "minInclusive maxInclusive")
        for key, attribute in (("min", "minInclusive"), ("max", "maxInclusive")):
            if attribute in valid.attributes:
                row[key] = valid.number(valid.attributes[attribute])

    def _size(self, size: Element) -> Size:
        size.checked("FixedValue DynamicValue", "maxSizeInBits")
        fixed, dynamic = size.child("FixedValue"), size.child("DynamicValue")
        if fixed is not None:
            return Size(fixed=8 * self._bytes(fixed, fixed.text))
        if dynamic is None:
            raise size.error("has no size", expected="FixedValue or DynamicValue")
        dynamic.checked("ParameterInstanceRef LinearAdjustment")
        reference = dynamic.need("ParameterInstanceRef").checked("", "parameterRef useCalibratedValue")
        line = dynamic.child("LinearAdjustment")
        if line is None:
            return Size(parameter=reference.get("parameterRef"))
        line.checked("", "slope intercept")
        slope, intercept = (
            float(line.number(line.attributes.get(k, d))) for k, d in (("slope", "1"), ("intercept", "0"))
        )
        if not slope.is_integer() or not intercept.is_integer():
            raise line.error("slope and intercept must be whole numbers")
        return Size(0, reference.get("parameterRef"), int(slope), int(intercept))

    def _bytes(self, element: Element, text: str) -> int:
        bits = element.integer(text.strip())
        if bits <= 0 or bits % 8 or bits > 8 * 999:
            raise element.error("only whole bytes, 1 to 999, are supported", got=f"{bits} bits")
        return bits // 8
