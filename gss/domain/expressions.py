"""Expressions over telemetry values, with a fixed grammar and parser. Expressions cannot execute other code.

    or         := and ("or" and)*
    and        := not ("and" not)*
    not        := "not" not | comparison
    comparison := sum (("<" | "<=" | ">" | ">=" | "==" | "!=") sum)?
    sum        := product (("+" | "-") product)*
    product    := sign (("*" | "/") sign)*
    sign       := "-" sign | atom
    atom       := number | "text" | true | false | packet.field | function "(" or ("," or)* ")" | "(" or ")"

Functions: abs(x), sqrt(x), min(x, y, …), max(x, y, …). A missing value, a division by zero, and a result that is not finite
are *unknown*, with a reason. If one operand decides the result of ``and`` or ``or``, the result is known even if another
operand is unknown: ``false and unknown`` is false.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NoReturn

from gss.domain.errors import BadInput
from gss.domain.expression_parser import (
    ARITHMETIC,
    COMPARISONS,
    FUNCTIONS,
    CallNode,
    ConstantNode,
    ExpressionNode,
    ExpressionParser,
    FieldReference,
    Quantity,
)

ValueKind = Literal["number", "bool", "text"]
MAX_CHARACTERS = 500


@dataclass(frozen=True)
class Evaluation:
    """Result of an expression. ``value`` is None if the result is unknown; ``reason`` then states why."""

    value: Quantity | None
    reason: str = ""


@dataclass(frozen=True)
class Expression:
    """A parsed expression. ``text``: source text. ``references``: telemetry fields that it reads, without duplicates, in order
    of first use."""

    text: str
    references: tuple[FieldReference, ...]
    _root: ExpressionNode

    def kind(self, kinds: Mapping[str, ValueKind]) -> ValueKind:
        """Return the kind of the result. ``kinds``: ``packet.field`` to the kind of that field. Raises BadInput for an unknown
        field or an operand of the wrong kind."""
        return _kind(self._root, kinds)

    def value(self, values: Mapping[str, Quantity | None]) -> Evaluation:
        """Evaluate the expression. ``values``: ``packet.field`` to the value of that field. A field without an entry, or with
        None or NaN, is a missing value."""
        return _value(self._root, values)


def parse(text: str) -> Expression:
    """Parse an expression. Raises BadInput with the position of the error."""
    if not 0 < len(text.strip()) <= MAX_CHARACTERS:
        raise BadInput(
            "The expression is empty or too long",
            expected=f"1 – {MAX_CHARACTERS} characters",
            got=str(len(text.strip())),
        )
    parser = ExpressionParser(text)
    root = parser.whole()
    return Expression(text.strip(), tuple(dict.fromkeys(parser.references)), root)


# --- kinds --------------------------------------------------------------------------------------------------------


def _kind(node: ExpressionNode, kinds: Mapping[str, ValueKind]) -> ValueKind:
    if isinstance(node, ConstantNode):
        return "bool" if isinstance(node.value, bool) else "text" if isinstance(node.value, str) else "number"
    if isinstance(node, FieldReference):
        if str(node) not in kinds:
            raise BadInput(
                "The expression refers to an unknown telemetry field",
                expected="packet.field of the dictionary",
                got=str(node),
            )
        return kinds[str(node)]
    operand_kinds = [_kind(operand, kinds) for operand in node.operands]
    if node.name in ("==", "!="):
        if operand_kinds[0] != operand_kinds[1]:
            _wrong_kind(node, f"two values of one kind, not {operand_kinds[0]} and {operand_kinds[1]}")
        return "bool"
    operand_kind: ValueKind = "bool" if node.name in ("and", "or", "not") else "number"
    if any(kind != operand_kind for kind in operand_kinds):
        _wrong_kind(node, {"bool": "yes/no values, for example a comparison", "number": "numbers"}[operand_kind])
    return "bool" if operand_kind == "bool" or node.name in COMPARISONS else "number"


def _wrong_kind(node: CallNode, expected: str) -> NoReturn:
    name = "-" if node.name == "negative" else node.name
    raise BadInput(f"The operands of {name} at position {node.at + 1} have the wrong type", expected=expected)


# --- values -------------------------------------------------------------------------------------------------------


def _value(node: ExpressionNode, values: Mapping[str, Quantity | None]) -> Evaluation:
    if isinstance(node, ConstantNode):
        return Evaluation(node.value)
    if isinstance(node, FieldReference):
        value = values.get(str(node))
        if value is None or (isinstance(value, float) and not math.isfinite(value)):
            return Evaluation(None, f"{node} has no current value")
        return Evaluation(value)
    operands = [_value(operand, values) for operand in node.operands]
    if node.name in ("and", "or"):
        return _logical(node.name, operands)
    missing = next((evaluated for evaluated in operands if evaluated.value is None), None)
    if missing is not None:
        return missing
    return _applied(node.name, [evaluated.value for evaluated in operands if evaluated.value is not None])


def _logical(name: str, operands: Sequence[Evaluation]) -> Evaluation:
    decisive = name == "or"
    if any(operand.value is decisive for operand in operands):
        return Evaluation(decisive)
    return next((operand for operand in operands if operand.value is None), Evaluation(not decisive))


def _applied(name: str, operands: Sequence[Quantity]) -> Evaluation:
    if name == "not":
        return Evaluation(not operands[0])
    if name in ("==", "!="):
        return Evaluation((operands[0] == operands[1]) == (name == "=="))
    numbers = [operand for operand in operands if not isinstance(operand, str)]
    if len(numbers) != len(operands):
        return Evaluation(None, f"an operand of {name} is text")
    if name in COMPARISONS:
        return Evaluation(COMPARISONS[name](numbers[0], numbers[1]))
    try:
        result = _number(name, numbers)
    except ZeroDivisionError:
        return Evaluation(None, "division by zero")
    except ValueError:
        return Evaluation(None, "square root of a negative number")
    except OverflowError:
        return Evaluation(None, "the result is too large")
    return Evaluation(result) if math.isfinite(result) else Evaluation(None, "the result is too large")


def _number(name: str, numbers: Sequence[float]) -> float:
    if name == "negative":
        return -numbers[0]
    if name in ARITHMETIC:
        return ARITHMETIC[name](numbers[0], numbers[1])
    return FUNCTIONS[name][2](numbers)
