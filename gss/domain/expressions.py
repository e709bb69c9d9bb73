"""Expressions over telemetry: a closed grammar with its own parser. Nothing is executed but what this module implements.

    or         := and ("or" and)*
    and        := not ("and" not)*
    not        := "not" not | comparison
    comparison := sum (("<" | "<=" | ">" | ">=" | "==" | "!=") sum)?
    sum        := product (("+" | "-") product)*
    product    := sign (("*" | "/") sign)*
    sign       := "-" sign | atom
    atom       := number | "text" | true | false | packet.field | function "(" or ("," or)* ")" | "(" or ")"

Functions: abs(x), sqrt(x), min(x, y, …), max(x, y, …). A missing value, a division by zero, and a result that is not finite
are *unknown*, with a reason. ``and`` and ``or`` are decided by one operand if it suffices: ``false and unknown`` is false.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NoReturn

from gss.domain.errors import BadInput

Quantity = float | int | bool | str
ValueKind = Literal["number", "bool", "text"]
MOST_CHARACTERS = 500
DEEPEST = 30
"""Nesting of parentheses, signs and ``not``."""
TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<text>\"[^\"]*\"|'[^']*')"
    r"|(?P<name>[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)?)|(?P<sign><=|>=|==|!=|[-+*/<>(),]))"
)
ARITHMETIC: Mapping[str, Callable[[float, float], float]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
}
COMPARISONS: Mapping[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
FUNCTIONS: Mapping[str, tuple[int, int, Callable[[Sequence[float]], float]]] = {
    "abs": (1, 1, lambda x: abs(x[0])),
    "sqrt": (1, 1, lambda x: math.sqrt(x[0])),
    "min": (2, 20, min),
    "max": (2, 20, max),
}
"""(fewest arguments, most arguments, function)."""
WORDS = ("and", "or", "not", "true", "false", *FUNCTIONS)


@dataclass(frozen=True)
class Evaluation:
    """Result of an expression. ``value`` None: unknown, for this ``reason``."""

    value: Quantity | None
    reason: str = ""


@dataclass(frozen=True)
class FieldReference:
    """A telemetry field as the values' mapping names it: ``packet.field``."""

    packet: str
    field: str

    def __str__(self) -> str:
        return f"{self.packet}.{self.field}"


@dataclass(frozen=True)
class _Constant:
    value: Quantity


@dataclass(frozen=True)
class _Call:
    """An operator or function with its operands. ``at``: character where it begins."""

    name: str
    operands: tuple[_Node, ...]
    at: int


_Node = _Constant | FieldReference | _Call


@dataclass(frozen=True)
class Expression:
    """A parsed expression. ``text``: as written; ``references``: the fields it reads, each once, in order."""

    text: str
    references: tuple[FieldReference, ...]
    _root: _Node

    def kind(self, kinds: Mapping[str, ValueKind]) -> ValueKind:
        """Return the kind of the result. ``kinds``: of every known field by ``packet.field``. Raises BadInput for an unknown
        field or an operand of the wrong kind."""
        return _kind(self._root, kinds)

    def value(self, values: Mapping[str, Quantity | None]) -> Evaluation:
        """Evaluate with the values of the fields by ``packet.field``; a field without an entry, or with None or NaN, is
        missing."""
        return _value(self._root, values)


def parse(text: str) -> Expression:
    """Parse an expression. Raises BadInput with the character of the error."""
    if not 0 < len(text.strip()) <= MOST_CHARACTERS:
        raise BadInput(
            "The expression is empty or too long",
            expected=f"1 – {MOST_CHARACTERS} characters",
            got=str(len(text.strip())),
        )
    parser = _Parser(text)
    root = parser.whole()
    return Expression(text.strip(), tuple(dict.fromkeys(parser.references)), root)


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str
    at: int


def _tokens(text: str) -> list[_Token]:
    tokens, at = [], 0
    while text[at:].strip():
        token_match = TOKEN.match(text, at)
        if token_match is None:
            unread = text[at:].lstrip()
            raise BadInput(
                f"The expression has an unexpected character at position {len(text) - len(unread) + 1}",
                expected="numbers, packet.field, + - * / < <= > >= == != and or not ( )",
                got=unread[0],
            )
        kind = str(token_match.lastgroup)
        tokens.append(_Token(kind, token_match.group(kind), token_match.start(kind)))
        at = token_match.end()
    return tokens


class _Parser:
    """Recursive descent, one method per rule of the grammar."""

    def __init__(self, text: str) -> None:
        self._tokens, self._next, self._depth = [*_tokens(text), _Token("end", "", len(text))], 0, 0
        self.references: list[FieldReference] = []

    def whole(self) -> _Node:
        root = self._or()
        if self._token.kind != "end":
            self._fail("an operator or the end")
        return root

    @property
    def _token(self) -> _Token:
        return self._tokens[self._next]

    def _fail(self, expected: str) -> NoReturn:
        raise BadInput(
            f"The expression has an error at position {self._token.at + 1}",
            expected=expected,
            got=self._token.text or "the end",
        )

    def _takes(self, *texts: str) -> _Token | None:
        token = self._token
        if token.kind in ("sign", "name") and token.text in texts:
            self._next += 1
            return token
        return None

    def _needs(self, text: str) -> None:
        if not self._takes(text):
            self._fail(text)

    def _joined(self, operand: Callable[[], _Node], *names: str) -> _Node:
        left = operand()
        while token := self._takes(*names):
            left = _Call(token.text, (left, operand()), token.at)
        return left

    def _or(self) -> _Node:
        self._depth += 1
        if self._depth > DEEPEST:
            self._fail(f"at most {DEEPEST} nested parentheses")
        node = self._joined(self._and, "or")
        self._depth -= 1
        return node

    def _and(self) -> _Node:
        return self._joined(self._not, "and")

    def _not(self) -> _Node:
        return self._prefixed("not", "not", self._comparison)

    def _comparison(self) -> _Node:
        left = self._sum()
        if token := self._takes(*COMPARISONS):
            left = _Call(token.text, (left, self._sum()), token.at)
            if self._token.text in COMPARISONS:
                self._fail("and or or: comparisons cannot be chained")
        return left

    def _sum(self) -> _Node:
        return self._joined(self._product, "+", "-")

    def _product(self) -> _Node:
        return self._joined(self._sign, "*", "/")

    def _sign(self) -> _Node:
        return self._prefixed("-", "negative", self._atom)

    def _prefixed(self, sign: str, name: str, operand: Callable[[], _Node]) -> _Node:
        signs = []
        while token := self._takes(sign):
            signs.append(token)
            if len(signs) > DEEPEST:
                self._fail(f"at most {DEEPEST} signs")
        node = operand()
        for token in reversed(signs):
            node = _Call(name, (node,), token.at)
        return node

    def _atom(self) -> _Node:
        token = self._token
        if self._takes("("):
            node = self._or()
            self._needs(")")
            return node
        if token.kind not in ("number", "text", "name"):
            self._fail("a number, packet.field, a function or (")
        if token.kind == "name" and token.text in ("and", "or", "not"):
            self._fail("a number, packet.field, a function or (")
        self._next += 1
        if token.kind == "number":
            return _Constant(float(token.text))
        if token.kind == "text":
            return _Constant(token.text[1:-1])
        return self._named(token)

    def _named(self, token: _Token) -> _Node:
        if token.text in ("true", "false"):
            return _Constant(token.text == "true")
        if token.text in FUNCTIONS:
            return self._function(token)
        packet, dot, field = token.text.partition(".")
        if not dot:
            self._next -= 1
            self._fail(f"packet.field, or one of {', '.join(FUNCTIONS)}; text is written in quotes")
        reference = FieldReference(packet, field)
        self.references.append(reference)
        return reference

    def _function(self, token: _Token) -> _Node:
        self._needs("(")
        operands = [self._or()]
        while self._takes(","):
            operands.append(self._or())
        self._needs(")")
        least, most, _ = FUNCTIONS[token.text]
        if not least <= len(operands) <= most:
            raise BadInput(
                f"The function {token.text} at position {token.at + 1} has a wrong number of arguments",
                expected=str(least) if least == most else f"{least} – {most}",
                got=str(len(operands)),
            )
        return _Call(token.text, tuple(operands), token.at)


# --- kinds --------------------------------------------------------------------------------------------------------


def _kind(node: _Node, kinds: Mapping[str, ValueKind]) -> ValueKind:
    if isinstance(node, _Constant):
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
    wanted: ValueKind = "bool" if node.name in ("and", "or", "not") else "number"
    if any(one != wanted for one in operand_kinds):
        _wrong_kind(node, {"bool": "yes/no values, for example a comparison", "number": "numbers"}[wanted])
    return "bool" if wanted == "bool" or node.name in COMPARISONS else "number"


def _wrong_kind(node: _Call, expected: str) -> NoReturn:
    name = "-" if node.name == "negative" else node.name
    raise BadInput(f"The operands of {name} at position {node.at + 1} are of the wrong kind", expected=expected)


# --- values -------------------------------------------------------------------------------------------------------


def _value(node: _Node, values: Mapping[str, Quantity | None]) -> Evaluation:
    if isinstance(node, _Constant):
        return Evaluation(node.value)
    if isinstance(node, FieldReference):
        value = values.get(str(node))
        if value is None or (isinstance(value, float) and not math.isfinite(value)):
            return Evaluation(None, f"{node} has no current value")
        return Evaluation(value)
    operands = [_value(operand, values) for operand in node.operands]
    if node.name in ("and", "or"):
        return _logical(node.name, operands)
    missing = next((one for one in operands if one.value is None), None)
    if missing is not None:
        return missing
    return _applied(node.name, [one.value for one in operands if one.value is not None])


def _logical(name: str, operands: Sequence[Evaluation]) -> Evaluation:
    decisive = name == "or"
    if any(one.value is decisive for one in operands):
        return Evaluation(decisive)
    return next((one for one in operands if one.value is None), Evaluation(not decisive))


def _applied(name: str, operands: Sequence[Quantity]) -> Evaluation:
    if name == "not":
        return Evaluation(not operands[0])
    if name in ("==", "!="):
        return Evaluation((operands[0] == operands[1]) == (name == "=="))
    numbers = [one for one in operands if not isinstance(one, str)]
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
